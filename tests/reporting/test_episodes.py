"""Single alarms become episodes as a person would mark them."""

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate.reporting.episodes import IDLE, PAUSE, Episode, episodes

Bool = NDArray[np.bool_]


def flags(*ranges: tuple[int, int], length: int = 400) -> Bool:
    made = np.zeros(length, dtype=bool)
    for start, stop in ranges:
        made[start:stop] = True
    return made


def ends(suspected: Bool, sent: Bool | None = None) -> list[tuple[int, int]]:
    arrived = np.ones_like(suspected) if sent is None else sent
    return [(e.start, e.stop) for e in episodes(suspected, arrived)]


def test_nobody_suspected_is_no_episode() -> None:
    assert ends(flags()) == []
    assert ends(flags(), flags()) == []


def test_gaps_of_a_few_samples_do_not_end_an_episode_and_a_pause_does() -> None:
    assert ends(flags((100, 150), (155, 200))) == [(100, 199)]
    assert ends(flags((100, 150), (150 + PAUSE, 300))) == [(100, 149), (150 + PAUSE, 299)]


@pytest.mark.parametrize("alarm", [80, 90, 95])
def test_an_alarm_shortly_before_a_lie_does_not_date_it(alarm: int) -> None:
    assert ends(flags((alarm, alarm + 1), (100, 200)))[-1] == (100, 199)


def test_a_liar_on_and_off_has_one_episode_with_the_share_that_it_was_suspected() -> None:
    on = np.random.default_rng(4).random(400) < 0.5
    on[:100] = on[300:] = False
    (one,) = episodes(on, np.ones(400, dtype=bool))
    assert 95 < one.start < 105 and 290 < one.stop < 300
    assert one.suspected == on[one.start : one.stop + 1].sum() and one.sent == one.stop - one.start + 1
    assert one.persistent and 0.4 < one.share < 0.6


def test_samples_that_did_not_arrive_are_no_gap() -> None:
    suspected, sent = flags(), flags()
    suspected[::10] = sent[::10] = True
    (one,) = episodes(suspected, sent)
    assert (one.start, one.stop, one.suspected, one.sent, one.persistent) == (0, 390, 40, 40, True)


def test_ten_of_twenty_samples_persist_and_nine_do_not() -> None:
    alternating = flags()
    alternating[100:118:2] = True
    assert not episodes(alternating, np.ones(400, dtype=bool))[0].persistent
    alternating[118] = True
    assert episodes(alternating, np.ones(400, dtype=bool))[0].persistent


def test_it_lasts_until_the_end_if_hardly_anything_came_after_it() -> None:
    everything = np.ones(400, dtype=bool)
    assert [e.until_end for e in episodes(flags((100, 200), (300, 395)), everything)] == [False, True]
    silent_then = flags((0, 205))
    assert episodes(flags((100, 200)), silent_then)[0].until_end


@pytest.mark.parametrize("seed", range(20))
def test_episodes_are_the_maximal_stretches_of_a_search_over_all(seed: int) -> None:
    """Ruzzo and Tompa: the largest stretch, then the largest left and right of it, and so on."""
    rng = np.random.default_rng(seed)
    suspected = rng.random(PAUSE) < rng.uniform(0.1, 0.9)
    assert ends(suspected) == searched(np.where(suspected, 1.0, -IDLE), 0)


def searched(scores: NDArray[np.float64], offset: int) -> list[tuple[int, int]]:
    total = np.concatenate([[0.0], np.cumsum(scores)])
    pairs = itertools.combinations(range(scores.size + 1), 2)
    score, _, a, b = max(((total[b] - total[a], a - b, a, b) for a, b in pairs), default=(0.0, 0, 0, 0))
    if score <= 0:
        return []
    here = (offset + a, offset + b - 1)
    return [*searched(scores[:a], offset), here, *searched(scores[b:], offset + b)]


def test_chance_gives_as_many_pairs_of_alarms_as_stated() -> None:
    rate, samples = 0.02, 400_000
    found = episodes(np.random.default_rng(5).random(samples) < rate, np.ones(samples, dtype=bool))
    pair = Episode(0, 1, suspected=2, sent=2, persistent=False, until_end=False)
    pairs = sum(e.suspected >= 2 and e.sent == e.suspected for e in found)
    assert pairs == pytest.approx(pair.by_chance(rate, samples), rel=0.25)
