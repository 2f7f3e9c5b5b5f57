import dataclasses
import importlib
from pkgutil import walk_packages
from typing import Annotated, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest

import kilnflight
from kilnflight.belt.models import IV
from kilnflight.checks import (
    Count,
    CountFrom0,
    InputError,
    Number,
    Positive,
    Settings,
    Share,
    Unlimited,
    check_flags,
    check_number,
)


@pytest.mark.parametrize(
    "value", [0.0, 1.0, 1.5, -1, True, "0.5", None, np.nan, np.inf, 10**400]
)
def test_what_is_no_number_within_the_limits_is_refused(value):
    with pytest.raises(InputError, match="share: "):
        check_number(value, "share", above=0, below=1)


def test_limits_may_be_allowed_and_whole_numbers_asked_for():
    check_number(0.5, "share", above=0, below=1)
    check_number(1, "share", least=1, most=1)
    check_number(np.int64(2), "count", least=1, whole=True)
    check_number(2.0, "count", least=1, whole=True)
    for value in (2.5, 0, True):
        with pytest.raises(InputError, match="count: "):
            check_number(value, "count", least=1, whole=True)


def settings_of(kind=Settings):
    """Yield all settings of the package."""
    for module in walk_packages(kilnflight.__path__, "kilnflight."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    waiting = [kind]
    while waiting:
        found = waiting.pop().__subclasses__()
        waiting += found
        yield from (each for each in found if dataclasses.is_dataclass(each))


def numbers_of(kind):
    """Return the kinds of numbers within the kind of a field."""
    if kind in (int, float) or get_origin(kind) is Annotated:
        return [kind]
    return [each for part in get_args(kind) for each in numbers_of(part)]


def test_each_number_of_settings_states_its_range():
    unstated = [
        f"{each.__name__}.{name}"
        for each in settings_of()
        for name, kind in get_type_hints(each, include_extras=True).items()
        if name in {field.name for field in dataclasses.fields(each)}
        and {int, float} & {*numbers_of(kind)}
    ]
    assert not unstated


class Some(Settings):
    share: Share = 0.5
    count: Count | None = None
    far: Unlimited = np.inf
    flag: bool = False
    word: Literal["a", "b"] = "a"
    pair: tuple[CountFrom0, Number] = (0, 1.0)
    several: tuple[Positive, ...] = ()


@pytest.mark.parametrize(
    "given",
    [
        {"share": 1.5},
        {"share": np.nan},
        {"share": "0.5"},
        {"share": None},
        {"count": 0},
        {"count": 1.5},
        {"count": True},
        {"far": -np.inf},
        {"flag": "no"},
        {"flag": 1},
        {"word": "c"},
        {"pair": (0,)},
        {"pair": (-1, 0.0)},
        {"pair": 3},
        {"several": (1.0, 0.0)},
    ],
    ids=str,
)
def test_settings_refuse_what_is_not_of_their_kinds(given):
    (name,) = given
    with pytest.raises(InputError, match=f"Some: {name}"):
        Some(**given)


def test_settings_keep_numbers_as_those_of_python():
    numpys = {
        "count": np.int64(3),
        "flag": np.True_,
        "pair": np.array([2, 5]),
        "several": [np.float32(0.5)],
    }
    pythons = {"count": 3, "flag": True, "pair": (2, 5), "several": (0.5,)}
    assert repr(Some(**numpys)) == repr(Some(**pythons))


class Nothing:
    """What no setting is."""


NEVER = [
    np.nan,
    -np.inf,
    -(10**400),
    -1e200,
    "no",
    "1",
    [],
    (np.nan, np.nan),
    (np.nan,) * 3,
    ["a", "b"],
    np.array([[1.0, 2.0]]),
    np.ma.masked,
    np.ma.masked_array([1.0, 2.0], [False, True]),
    1j,
    b"1",
    Nothing(),
]
NEEDED = {
    "Motion": {"velocity": (0.0, 0.0), "spreads": (1.0, 1.0), "noise": 1.0},
    "Cylinder": {"centre_mm": (0, 0, 0), "direction": (0, 0, 1), "radius_mm": 1.0},
}
NEEDED["Wandering"] = NEEDED["Motion"]


def test_no_settings_take_what_none_of_them_can_be():
    taken = []
    for kind in settings_of():
        if kind is Some:
            continue
        needed = NEEDED.get(kind.__name__, {})
        try:
            kind(**needed)
        except TypeError:  # abstract, or made of other parts
            continue
        for field in dataclasses.fields(kind):
            for value in NEVER:
                if value is field.default:  # NaN: not calibrated
                    continue
                try:
                    kind(**needed | {field.name: value})
                except InputError:
                    continue
                taken.append((kind.__name__, field.name, value))
    assert not taken


def test_a_default_is_not_checked_and_may_say_that_nothing_is_known():
    assert np.isnan(IV().velocity_mm_s)
    for value in (0.0, -1.0, "1", np.inf):
        with pytest.raises(InputError, match="IV: velocity_mm_s"):
            IV(value)


@pytest.mark.parametrize("value", [0, 1.0, "no", "", None, [True], np.array([True])])
def test_yes_and_no_are_no_numbers_and_no_words(value):
    check_flags("flag", True, np.False_)
    with pytest.raises(InputError, match="flag"):
        check_flags("flag", True, value)
