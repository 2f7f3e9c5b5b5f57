"""Operations that fail one after another: a run again ends in the same bytes."""

import pytest
from tests.faults.runs import OPERATIONS, Failing, content, moving, run, spots

from kilnflight.checks import InputError
from kilnflight.film import pictures


@pytest.mark.parametrize("operation", OPERATIONS)
def test_a_run_whose_nth_operation_failed_goes_on_to_the_same_bytes(
    tmp_path, operation, monkeypatch
):
    film = spots(moving(1, 2))

    def run_into(folder):
        run(film, folder)
        return content(folder)

    # a picture costs most of the time, and drawing writes nothing
    monkeypatch.setattr(pictures, "png", lambda figure: b"a picture")
    monkeypatch.setattr(pictures, "pictures", lambda *_: [("tracks", None)])
    expected = run_into(tmp_path / "right")
    error, place, name = OPERATIONS[operation]
    call = getattr(place, name)
    for n in range(1, 1000):
        failing = Failing(call, n, error)
        folder = tmp_path / f"{n}"
        with monkeypatch.context() as patched:
            # a function is bound to the path, as the original is
            patched.setattr(place, name, lambda *a, _call=failing, **o: _call(*a, **o))
            try:
                run_into(folder)
            except (InputError, OSError, MemoryError):
                assert failing.n <= 0
        assert run_into(folder) == expected
        if failing.n > 0:
            assert n > 10
            break
