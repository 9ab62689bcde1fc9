"""`mantis explore`: a local page over cached transport, on which a move of a slider recomputes the whole chain."""
