"""The form of a material's data file: a TOML file, checked key by key before it becomes a `materials.library.Material`.

A spectral entry is one number, which holds at every wavelength, or a list of [wavelength_nm, value] pairs. Between the
pairs it is linear, beyond them constant.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from materials.brdf import Lobes, RetroTable
from radiometry.spectrum import Spectrum, constant

#: Wavelengths over which every spectrum is given, so that nothing is zero beyond a table's ends [nm].
_LOW_NM, _HIGH_NM = 300.0, 1200.0


def _spectral(highest: float, quantity: str) -> Callable[[Any], Spectrum]:
    """Reader of a spectral entry whose values lie between 0 and `highest`."""

    def read(entry: Any) -> Spectrum:
        if isinstance(entry, Spectrum):
            return entry
        form = f"expected {quantity} from 0 to {highest:g}, or a list of [wavelength in nm, {quantity}]"
        try:
            table = np.array(entry, float)
        except (TypeError, ValueError):
            raise ValueError(f"{entry!r}, {form}") from None
        pairs = table.ndim == 2 and table.shape[1] == 2 and len(table) >= 2
        if isinstance(entry, bool) or not (table.ndim == 0 or pairs) or not np.all(np.isfinite(table)):
            raise ValueError(f"{entry!r}, {form}")
        values = table[:, 1] if pairs else table.reshape(1)
        wrong = values[(values < 0) | (values > highest)]
        if len(wrong):
            raise ValueError(f"{wrong[0]:g}, {form}")
        if not pairs:
            return constant(float(table), _LOW_NM, _HIGH_NM)
        wavelength = table[:, 0]
        if np.any(np.diff(wavelength) <= 0) or wavelength[0] < _LOW_NM or wavelength[-1] > _HIGH_NM:
            raise ValueError(f"wavelengths {wavelength} must increase and lie in {_LOW_NM:g}-{_HIGH_NM:g} nm")
        grid = np.union1d(wavelength, [_LOW_NM, _HIGH_NM])
        return Spectrum(grid, np.interp(grid, wavelength, values))

    return read


Albedo = Annotated[Spectrum, BeforeValidator(_spectral(1.0, "an albedo"))]
Factor = Annotated[Spectrum, BeforeValidator(_spectral(10.0, "a factor"))]
Text = Annotated[str, Field(min_length=1)]


def _increase(angles: tuple[float, ...]) -> tuple[float, ...]:
    if any(b <= a for a, b in pairwise(angles)):
        raise ValueError(f"{list(angles)}, expected angles that increase [deg]")
    return angles


_Observation = Annotated[float, Field(gt=0, le=180, allow_inf_nan=False)]
_Entrance = Annotated[float, Field(ge=0, lt=89, allow_inf_nan=False)]
_Coefficient = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


class Sourced(_Entry):
    """Where figures come from. `assumption` says that some of them have no source."""

    source: Text = Field(description="publication, standard or data sheet, or what is assumed")
    date: Annotated[str, BeforeValidator(str)] = Field(description="when the source was made or read")
    uncertainty: Text = Field(description="of the figures, in words")
    assumption: bool = Field(description="true where a figure has no source that was read")


class _Diffuse(_Entry):
    albedo: Albedo = Field(description="Lambertian albedo [-]")


class _Gloss(_Entry):
    albedo: Albedo = Field(description="reflectance of the microfacets [-]")
    ggx_alpha: Annotated[float, Field(ge=0.01, le=1)] = Field(description="GGX roughness [-]")


class _Retro(_Entry):
    observation_deg: Annotated[tuple[_Observation, ...], AfterValidator(_increase)] = Field(
        min_length=1, description="observation angles, increasing [deg]"
    )
    entrance_deg: Annotated[tuple[_Entrance, ...], AfterValidator(_increase)] = Field(
        min_length=1, description="entrance angles, increasing [deg]"
    )
    coefficient_cd_per_lx_m2: tuple[tuple[_Coefficient, ...], ...] = Field(
        description="R_A, a row for each entrance angle [cd/(lx m²) = 1/sr]"
    )
    tail_exponent: float = Field(
        3.0,
        gt=2,
        allow_inf_nan=False,
        description="fall-off beyond the last observation angle, above 2 for a finite energy [-]",
    )
    spectral_factor: Factor = Field(constant(1.0, _LOW_NM, _HIGH_NM), description="of the table, over wavelength [-]")

    @model_validator(mode="after")
    def _is_a_table(self) -> _Retro:
        rows, columns = len(self.entrance_deg), len(self.observation_deg)
        lengths = [len(row) for row in self.coefficient_cd_per_lx_m2]
        if lengths != [columns] * rows:
            raise ValueError(
                f"coefficient_cd_per_lx_m2 has rows of {lengths} values, expected {rows} (entrance angles) of {columns} "
                f"(observation angles) [1/sr]"
            )
        self.table()
        return self

    def table(self) -> RetroTable:
        """The table that the budget and the renderer evaluate."""
        return RetroTable(self.observation_deg, self.entrance_deg, self.coefficient_cd_per_lx_m2, self.tail_exponent)


_Wear = Annotated[float, Field(ge=0, le=10)]


class EndOfLife(Sourced):
    """Factors on each lobe after the mission."""

    diffuse: _Wear = Field(1.0, description="factor on the Lambertian albedo [-]")
    gloss: _Wear = Field(1.0, description="factor on the microfacets' reflectance [-]")
    retro: _Wear = Field(1.0, description="factor on the retro table [-]")


class MaterialFile(Sourced):
    """A checked data file."""

    title: Text = Field(description="what the material is, in one line")
    diffuse: _Diffuse
    gloss: _Gloss | None = None
    retro: _Retro | None = None
    end_of_life: EndOfLife | None = None

    def lobes(self) -> Lobes:
        """Shape of the reflectance that the file describes."""
        return Lobes(self.retro.table() if self.retro else None, self.gloss.ggx_alpha if self.gloss else None)


def parse(text: str, name: str) -> MaterialFile:
    """Read and check the text of a data file.

    Args:
        text: the TOML text.
        name: of the material, for messages.

    Raises:
        ValueError: one line with the file's name, the key, its value, what was expected, and the unit.
    """
    try:
        return MaterialFile.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"material {name}: not a TOML file ({error})") from None
    except ValidationError as error:
        raise ValueError(f"material {name}: {_explain(error)}") from None


def _explain(error: ValidationError) -> str:
    # A misspelt key is also a missing one: name the misspelling.
    first, *rest = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    key = ".".join(map(str, first["loc"])) or "file"
    more = f" (and {len(rest)} more)" if rest else ""
    model, about = _described(first["loc"])
    if first["type"] == "value_error":
        return f"{key}: {first['ctx']['error']}{more}"
    if first["type"] == "extra_forbidden":
        return f"{key}: unknown key, expected one of {', '.join(model.model_fields)}{more}"
    if first["type"] == "missing":
        return f"{key}: missing, expected {about}{more}"
    wanted = first["msg"].replace("Input should be", "expected").split(", unable")[0].replace("a valid tuple", "a list")
    if first["type"] == "model_type":
        wanted = "expected a table"
    return f"{key}: {first['input']!r}, {wanted} ({about}){more}"


def _described(location: tuple[int | str, ...]) -> tuple[type[BaseModel], str]:
    """The table in which a key stands, and the key's description with its unit."""
    tables: dict[str, type[BaseModel]] = {
        "diffuse": _Diffuse,
        "gloss": _Gloss,
        "retro": _Retro,
        "end_of_life": EndOfLife,
    }
    model: type[BaseModel] = MaterialFile
    about = ""
    for k, part in enumerate(location):
        if part not in model.model_fields:
            break
        about = model.model_fields[str(part)].description or f"table [{part}]"
        if k == 0:
            model = tables.get(str(part), model)
    return model, about
