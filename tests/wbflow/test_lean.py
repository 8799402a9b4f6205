"""Data classes that are made late behave as those of the standard library."""

from __future__ import annotations

import dataclasses
import pickle
from typing import Any

import pytest

from wbflow.lean import dataclass


@dataclass(frozen=True)
class Place:
    """Frozen: can be a key."""

    name: str
    height: float = 2.5
    seen: list[int] = dataclasses.field(default_factory=list, compare=False, repr=False)


@dataclass
class Visit:
    """Can be changed."""

    place: Place
    minutes: int = 1
    twice: int = dataclasses.field(init=False, default=0)

    def __post_init__(self) -> None:
        self.twice = 2 * self.minutes


def test_fields_are_given_by_place_or_name_and_have_defaults_of_their_own() -> None:
    one, other = Place("gate"), Place(name="gate", height=2.5)
    one.seen.append(1)
    assert (one.name, one.height, other.seen) == ("gate", 2.5, [])
    assert (Visit(one, 3).twice, Visit(one).minutes) == (6, 1)


def test_equal_objects_are_one_key_and_what_does_not_count_does_not_tell_them_apart() -> None:
    assert Place("gate", seen=[1]) == Place("gate") != Place("roof")
    assert len({Place("gate"), Place("gate", 2.5, [3]), Place("roof")}) == 2
    assert Visit(Place("gate")) == Visit(Place("gate"), 1) != Visit(Place("gate"), 2)
    with pytest.raises(TypeError, match="unhashable"):
        hash(Visit(Place("gate")))


def test_frozen_objects_cannot_be_changed() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError, match="name"):
        Place("gate").name = "roof"  # type: ignore[misc]
    with pytest.raises(dataclasses.FrozenInstanceError, match="name"):
        del Place("gate").name


@pytest.mark.parametrize(("given", "what"), [({}, "missing"), ({"name": "gate", "width": 1}, "width")])
def test_wrong_arguments_are_refused_by_name(given: dict[str, Any], what: str) -> None:
    for _ in range(2):  # the first time it is compiled
        with pytest.raises(TypeError, match=rf"Place.*{what}"):
            Place(**given)


def test_the_standard_library_knows_them() -> None:
    visit = Visit(Place("gate"), 4)
    assert dataclasses.asdict(visit) == {"place": {"name": "gate", "height": 2.5, "seen": []}, "minutes": 4, "twice": 8}
    assert dataclasses.replace(visit.place, height=3.0) == Place("gate", 3.0)
    assert pickle.loads(pickle.dumps(visit)) == visit
    assert repr(visit) == "Visit(place=Place(name='gate', height=2.5), minutes=4, twice=8)"
