"""What a film's settings are prepared from."""

import pytest

from kilnflight.film.preparation import choose_enlargement


class Counted:
    """Looks that show given numbers of spots at 1, 2 and 4 times their size."""

    def __init__(self, *numbers):
        self.numbers = dict(zip((1, 2, 4), numbers, strict=True))

    def count(self, background, enlarge):
        return self.numbers[enlarge]


@pytest.mark.parametrize(
    ("numbers", "small", "enlarge"),
    [
        ((10, 10, 20), False, 1),  # no more than twice as many
        ((10, 10, 21), False, 4),
        ((10, 14, 20), False, 1),  # no more than 1.4 times as many
        ((10, 15, 20), False, 2),
        ((10, 10, 20), True, 2),
        ((10, 15, 31), True, 4),
    ],
)
def test_a_film_is_enlarged_where_that_shows_many_more_spots(numbers, small, enlarge):
    chosen, reason = choose_enlargement(Counted(*numbers), "median", small)
    assert chosen == enlarge
    assert all(str(number) in reason for number in numbers)
