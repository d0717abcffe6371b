"""Every key of every format that users write changes something that comes out, or describes: one walk over all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import pytest
from pydantic import BaseModel, ValidationError

from sim_heating.base.files import toml_text
from sim_heating.cli.path_check import DESCRIBING, descriptions
from sim_heating.formats.catalogue import formats_with_schema
from tests.support.key_deeds import DEEDS, Document
from tests.support.key_table import ELSEWHERE, REFUSES, VALUES
from tests.support.key_walk import Deed, acts, at, changed, keys_of, owner, present
from tests.support.paths import ROOT

FORMATS = [declared.load() for declared in formats_with_schema() if declared.language == "toml"]
KEYS = sorted({key for model in FORMATS for key in keys_of(model)})


def describes(key: str, kinds: dict[str, object]) -> bool:
    """Whether a key states its format, or a text that describes."""
    name = key.partition(".")[2]
    return name == "format" or (name in DESCRIBING and kinds[key] in (str, str | None))


def kinds_of_keys() -> dict[str, object]:
    """Type of the value of each key."""
    from tests.support.key_walk import models_of

    models: list[type[BaseModel]] = []
    for model in FORMATS:
        models_of(model, models)
    return {f"{owner(m, name)}.{name}": field.annotation for m in models for name, field in m.model_fields.items()}


KINDS = kinds_of_keys()
WALKED = [key for key in KEYS if not describes(key, KINDS) and key not in ELSEWHERE]
WALKED.sort(key=lambda key: sha256(key.encode()).hexdigest())  # in an order that other keys do not change
SAMPLE = int(os.environ.get("SIM_HEATING_WALKED_KEYS", "12"))
"""How many keys are walked; the whole walk, with a large number in this variable, takes ten minutes of a processor."""


def documents(path: Path) -> Iterator[tuple[Deed, Document, Path]]:
    """Each deed with its document, and the folder of its own that this names files in."""
    for i, deed in enumerate(DEEDS):
        folder = path / str(i)
        folder.mkdir()
        yield deed, deed.document(folder), folder


@pytest.fixture(scope="session")
def stated(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[int]]:
    """Numbers of the deeds whose document states a key."""
    found: dict[str, list[int]] = {}
    for i, (deed, document, _) in enumerate(documents(tmp_path_factory.mktemp("deeds"))):
        for key in dict.fromkeys(key for key, _ in present(deed.model.model_validate(document))):
            found.setdefault(key, []).append(i)
    return found


def test_every_key_is_stated_by_a_deed(stated: dict[str, list[int]]) -> None:
    assert [key for key in WALKED if key not in stated] == []


@pytest.mark.sample(3)
@pytest.mark.parametrize("key", WALKED[:SAMPLE])
def test_key_acts(key: str, stated: dict[str, list[int]], tmp_path: Path) -> None:
    reasons = []
    for i in stated.get(key, []):
        folder = tmp_path / str(i)
        folder.mkdir()
        reason = acts(DEEDS[i], key, VALUES.get(key, ()), folder, REFUSES.get(key, ""))
        if not reason:
            return
        reasons.append(f"{DEEDS[i].name}: {reason}")
    pytest.fail("; ".join(reasons) or "no deed states it")


@pytest.mark.thorough
def test_keys_that_describe_are_told_by_validate(tmp_path: Path) -> None:
    shown = set()
    for deed, document, folder in documents(tmp_path):
        for key, place in present(deed.model.model_validate(document)):
            if describes(key, KINDS) and not key.endswith(".format") and key not in shown:
                assert isinstance(at(document, place), str)
                (folder / deed.file).write_text(toml_text(changed(document, place, "a text that describes")))
                told = descriptions(folder / deed.file)
                assert "a text that describes" in [text for texts in told.values() for text in texts.values()], key
                shown.add(key)
    of_study = descriptions(ROOT / "scenarios" / "studies" / "optimal_entry.toml")["optimal_entry.toml"]
    shown |= {f"OptimalStudyFile.{key}" for key in of_study}
    described = {key for key in KEYS if describes(key, KINDS) and not key.endswith(".format")}
    assert sorted(described - shown - set(ELSEWHERE)) == []


def test_another_format_is_refused(tmp_path: Path) -> None:
    refused = set()
    for deed, document, _ in documents(tmp_path):
        if "format" in document and deed.model not in refused:
            with pytest.raises(ValidationError):
                deed.model.model_validate(document | {"format": "another/9"})
            refused.add(deed.model)
    assert len(refused) >= 9


def test_table_of_the_walk_names_keys_that_exist() -> None:
    assert {*VALUES, *ELSEWHERE} <= set(KEYS)


@pytest.mark.parametrize("test", sorted(set(ELSEWHERE.values())))
def test_what_acts_elsewhere_is_named_there(test: str) -> None:
    text = (ROOT / test).read_text()
    absent = [key for key, place in ELSEWHERE.items() if place == test and key.partition(".")[2] not in text]
    assert absent == []
