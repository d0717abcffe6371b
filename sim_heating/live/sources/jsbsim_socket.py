"""JSBSim's own output of type SOCKET: a line `<LABELS> ,Time,alpha_deg`, then a line of values a frame.

A label is the caption that the output gives its property, else the last part of the property's name. JSBSim sends the
labels once, when it starts: for an output that began before the link, the link file names the fields.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sim_heating.base.errors import InputError
from sim_heating.base.files import repeated_name
from sim_heating.base.files.text import abbreviated

LABELS = "<LABELS>"


class JSBSimDecoder:
    """Decodes the lines of one JSBSim; new labels, of a JSBSim that starts again, take the place of the last ones.

    fields : labels before the first line of labels
    """

    def __init__(self, fields: Sequence[str] = ()) -> None:
        self.fields = tuple(fields)

    def decode(self, body: bytes) -> Mapping[str, float | str] | None:
        """Values of one line by label; None for a line of labels; InputError where the numbers of both differ."""
        text = body.decode("utf-8", errors="replace").strip()
        if not text:
            return None
        cells = [cell.strip() for cell in text.split(",")]
        if text.startswith(LABELS):
            fields = tuple(cell for cell in (cells[0].removeprefix(LABELS).strip(), *cells[1:]) if cell)
            if (name := repeated_name(fields)) is not None:
                raise InputError(f"JSBSim sends two fields named {name}; give one of them another caption")
            self.fields = fields
            return None
        if not self.fields:
            raise InputError("JSBSim's line of labels has not come; start JSBSim after the link, or name `fields`")
        if len(cells) != len(self.fields):
            raise InputError(f"{abbreviated(text)} has {len(cells)} values for {len(self.fields)} labels")
        return {name: _value(cell) for name, cell in zip(self.fields, cells, strict=True)}


def _value(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell
