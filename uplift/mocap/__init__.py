"""Motion capture files, the joints that can be built from them, and virtual cameras that film them."""

from __future__ import annotations

__all__: list[str] = []
