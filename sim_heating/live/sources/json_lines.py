"""Lines of JSON: one object a line."""

from __future__ import annotations

import json
from collections.abc import Mapping

from sim_heating.base.errors import InputError
from sim_heating.base.files.text import abbreviated
from sim_heating.live.sources.decoder import flat


class JsonDecoder:
    """Decodes lines of JSON."""

    def decode(self, body: bytes) -> Mapping[str, float | str] | None:
        """Values of one line; None for a blank one; InputError where it is no JSON object."""
        text = body.decode("utf-8", errors="replace").strip()
        if not text:
            return None
        try:
            value = json.loads(text)
        except (ValueError, RecursionError) as error:
            reason = "nested too deeply" if isinstance(error, RecursionError) else str(error)
            raise InputError(f"{abbreviated(text)} is not JSON ({reason})") from None
        if not isinstance(value, dict):
            raise InputError(f"{abbreviated(text)} is not a JSON object; send one object a line")
        return flat(value)
