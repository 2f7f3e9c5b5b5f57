import dataclasses
import importlib
from pkgutil import walk_packages
from typing import Annotated, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest

import kilnflight
from kilnflight.checks import (
    Count,
    CountFrom0,
    InputError,
    Number,
    Positive,
    Settings,
    Share,
    Unlimited,
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


@dataclasses.dataclass(frozen=True)
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
