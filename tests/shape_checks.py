"""The checker of jaxtyping's shapes while the tests run: beartype, for which a whole number is a float too."""

from __future__ import annotations

from beartype import BeartypeConf, beartype

__all__ = ["check"]

check = beartype(conf=BeartypeConf(is_pep484_tower=True))
