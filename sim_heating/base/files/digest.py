"""Digests of JSON files: a file carries the digest of its own content, so that a reader notices any later change.

The digest depends on the content alone: not on the order of keys, on blanks and line ends, nor on whether a whole
number has a decimal point. It is a guard against accidents and edits by hand, not a signature.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from sim_heating.base.files.paths import text_digest
from sim_heating.base.files.results import json_text

DIGEST = "digest"
"""Key of the digest in a file."""


def content_digest(data: Mapping[str, Any]) -> str:
    """`sha256:...` of a JSON object, its own digest aside.

    The bytes behind it: JSON with sorted keys, no blanks, every number as a floating-point one, ASCII with escapes.
    """
    content = json.loads(json.dumps({k: v for k, v in data.items() if k != DIGEST}), parse_int=float)
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return text_digest(text)


def with_digest(data: Mapping[str, Any]) -> dict[str, Any]:
    """The data as plain values, with the digest of their content as the last key.

    raises : RunError naming the entry where a number is not finite
    """
    plain = json.loads(json_text(data))
    return {**{k: v for k, v in plain.items() if k != DIGEST}, DIGEST: content_digest(plain)}


def digest_matches(data: Mapping[str, Any]) -> bool:
    """Whether the digest that a JSON object carries is that of its content; False where it carries none."""
    try:
        return data.get(DIGEST) == content_digest(data)
    except RecursionError:  # nested more deeply than anything that is written with a digest
        return False
