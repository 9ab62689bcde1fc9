"""Types of number that the parameter models share; pydantic refuses everything outside them, NaN and infinity included."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

#: A finite number above zero.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
#: A share of a whole, 0 and 1 included.
Fraction = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
#: A share of a whole that is not nothing: above 0, up to 1.
PositiveFraction = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]
#: A share that is neither nothing nor the whole: above 0 and below 1.
OpenFraction = Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)]
