"""The cells of the benchmark of secure filters are what they say, and its limits are sums over all sets."""

import json
import re
from itertools import combinations
from math import comb
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from benches import secure_filter
from benches._secure_cells import CELLS, CLEAN, Cell, cell, episode
from benches._secure_limit import CELLS_WITH_LIMIT, _Bayes, gaussian, limit, sets
from benches._secure_methods import JUDGED, PARTS, methods, variant
from benches._secure_score import Result, against_best, attempt, relative
from securestate import InnovationMixture, KalmanFilter, OracleFilter

SEED = 11


def named(line: str) -> Cell:
    return next(one for one in CELLS if one.name == line)


@pytest.mark.parametrize("one", CELLS, ids=lambda one: one.name)
def test_as_many_sensors_lie_as_the_cell_says_and_only_after_the_clean_samples(one: Cell) -> None:
    drawn = episode(one, SEED)
    truth = drawn.trajectory
    lying = truth.attacked[0]
    assert not lying[: drawn.scored].any()
    assert len(lying) - drawn.scored == 100
    assert drawn.scored == (0 if one.cold else CLEAN)
    sizes = lying[drawn.scored :].sum(axis=1)
    low, high = (0, 0) if one.kind == "none" else one.count
    assert (sizes >= low).all()
    assert (sizes <= high).all()
    assert (lying[drawn.scored :] == lying[drawn.scored]).all() or not one.fixed
    assert not lying[:, truth.plant.protected].any()
    assert ((truth.a[0] == 0) | lying[:, truth.plant.channel_sensor]).all()


def test_there_are_86_cells_of_five_plants() -> None:
    assert len({one.name for one in CELLS}) == len(CELLS) == 86
    assert {one.plant for one in CELLS} == {"scalar", "partial4", "full4", "liu", "chen"}
    assert sum(one.cold for one in CELLS) == 9


@pytest.mark.parametrize("kind", ["26", "26c"])
def test_26_flips_the_innovation_of_a_sensors_own_filter(kind: str) -> None:
    truth = episode(named(f"scalar {kind} 1-6 dynamic"), SEED).trajectory
    A, Q = float(truth.plant.A[0, 0]), float(truth.plant.Q[0, 0])
    for i, (C, R) in enumerate(zip(truth.plant.C[:, 0], np.diag(truth.plant.R), strict=True)):
        P = float(solve_discrete_are([[A]], [[C]], [[Q]], [[R]])[0, 0])
        gain, z = P * C / (C * C * P + R), 0.0
        for k in range(truth.steps):
            before, after = truth.clean[0, k, i] - C * z, truth.y[0, k, i] - C * z
            assert after == pytest.approx(-before if truth.attacked[0, k, i] else before, abs=1e-8)
            z = A * (z + gain * (before if kind == "26c" else after))


def test_26f_flips_the_innovation_of_the_defender() -> None:
    drawn = episode(named("full4 26f 6 dynamic"), SEED)
    run, met = drawn.confront(KalmanFilter(drawn.trajectory.plant))
    expected = (run.x[0, :-1] @ met.plant.A.T) @ met.plant.C.T
    before, after = met.clean[0, 1:] - expected, met.y[0, 1:] - expected
    lies = met.attacked[0, 1:, met.plant.channel_sensor].T
    np.testing.assert_allclose(after, np.where(lies, -before, before), atol=1e-9)


def test_25_is_linear_in_the_noise_with_factors_drawn_at_every_sample() -> None:
    truth = episode(named("scalar 25pt 1-6 dynamic"), SEED).trajectory
    noise = truth.clean[0] - truth.x[0] @ truth.plant.C.T
    lies = truth.attacked[0]
    assert (np.abs(truth.a[0]) <= 5 * np.abs(noise) + 10)[lies].all()
    assert len(np.unique(truth.a[0][lies])) == lies.sum()


def test_simple_attacks_add_what_they_say() -> None:
    def injected(line: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        truth = episode(named(line), SEED).trajectory
        lies = truth.attacked[0].any(axis=0)
        return truth.a[0, CLEAN:, lies].T, truth.clean[0][:, lies], truth.plant.C[lies]

    k = np.arange(100)[:, np.newaxis]
    np.testing.assert_allclose(injected("scalar ramp:.02 6 fixed")[0], 0.02 * k * np.ones(6), atol=1e-12)
    alternating = injected("scalar alt:3 6 fixed")[0]
    np.testing.assert_allclose(alternating, 3 * (-1.0) ** k * np.ones(6), atol=1e-12)
    a, y, _ = injected("scalar replay:20 6 fixed")
    np.testing.assert_allclose(a, y[CLEAN - 20 : -20] - y[CLEAN:])
    a, y, _ = injected("partial4 freeze 3 fixed")
    np.testing.assert_allclose(a + y[CLEAN:], np.broadcast_to(y[CLEAN - 1], a.shape))
    assert set(np.unique(injected("scalar impulse:10 6 fixed")[0])) == {-10, 0, 10}
    a, _, C = injected("scalar coordramp:.1 7 fixed")
    np.testing.assert_allclose(a, 0.1 * k * C.T)
    a, _, C = injected("scalar sinc:2 6 fixed")
    np.testing.assert_allclose(a, 2 * np.sin(2 * np.pi * k / 25) * C.T, atol=1e-12)


def test_a_coordinated_shift_is_so_many_prior_deviations_long() -> None:
    truth = episode(named("partial4 coordsd:3 3 fixed"), SEED).trajectory
    plant, lies = truth.plant, truth.attacked[0].any(axis=0)
    P = solve_discrete_are(plant.A.T, plant.C.T, plant.Q, plant.R)
    variances, directions = np.linalg.eigh(P)
    shift = plant.C[lies] @ (3 * np.sqrt(variances[-1]) * directions[:, -1])
    told = truth.a[0, -1, lies]
    assert min(np.abs(told - shift).max(), np.abs(told + shift).max()) < 1e-6


def test_a_run_depends_on_its_cell_and_its_seed_only() -> None:
    one, other = cell("scalar bias:2 6 fixed"), cell("scalar bias:2 6 dynamic")
    y = episode(one, SEED).trajectory.y
    np.testing.assert_array_equal(y, episode(one, SEED).trajectory.y)
    assert not np.array_equal(y, episode(one, SEED + 1).trajectory.y)
    assert not np.array_equal(y, episode(other, SEED).trajectory.y)


def test_a_cold_start_is_that_of_the_package_and_the_oracle_starts_wide() -> None:
    drawn = episode(named("cold scalar bias:5 6 fixed"), SEED)
    estimator = InnovationMixture(drawn.trajectory.plant)
    run, _ = drawn.confront(estimator)
    again = estimator.run(drawn.trajectory.y, prior="window")
    np.testing.assert_array_equal(run.x, again.x)
    np.testing.assert_array_equal(run.suspected, again.suspected)
    oracle, _ = drawn.confront(OracleFilter(drawn.trajectory.plant))
    assert oracle.P is not None
    assert abs(oracle.x[0, 0, 0] - drawn.trajectory.x[0, 0, 0]) < 5 * np.sqrt(oracle.P[0, 0, 0, 0])


def test_numbers_do_not_depend_on_the_number_of_processes_nor_on_an_interruption(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [
        "--runs",
        "6",
        "--first-seed",
        "3",
        "--cells",
        "chen.(bias|none)",
        "--methods",
        "kalman,joint",
    ]
    one, two, parts = (tmp_path / name for name in ("one.json", "two.json", "parts.json"))
    assert secure_filter.main([*arguments, "--processes", "1", "--out", str(one)]) == 0
    whole = capsys.readouterr().out
    assert secure_filter.main([*arguments, "--processes", "2", "--out", str(two)]) == 0
    capsys.readouterr()
    kept = json.loads(one.read_text())
    del kept["cells"]["chen bias:1 2 fixed"]
    parts.write_text(json.dumps(kept))
    assert secure_filter.main([*arguments, "--processes", "1", "--resume", "--out", str(parts)]) == 0
    resumed = capsys.readouterr().out
    assert without_seconds(one) == without_seconds(two) == without_seconds(parts)
    for table in (whole, resumed):
        assert re.search(r"\| kalman \| 3 \| [\d.]+ \|", table)
        assert "| chen bias:5 2 dynamic | 1 |" in table


def without_seconds(path: Path) -> dict[str, list[list[float]]]:
    cells = json.loads(path.read_text())["cells"]
    return {
        f"{line}: {name}": [[*row[:6], *row[7:]] for row in one["rows"]]
        for line, results in sorted(cells.items())
        for name, one in results.items()
    }


def test_unknown_methods_and_cells_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert secure_filter.main(["--methods", "oraacle"]) == 2
    assert "oraacle" in capsys.readouterr().err
    assert secure_filter.main(["--cells", "no such cell"]) == 2


def test_every_registered_method_takes_part_or_says_why_not() -> None:
    results = attempt(named("chen bias:1 2 fixed"), SEED, list(methods()))
    assert all(one.rows for one in results.values())
    refused = attempt(named("liu bias:5 1 fixed"), SEED, ["joint", "kalman"])
    assert "protected" in refused["joint"].refused
    assert refused["kalman"].rows


def test_the_secure_filter_is_judged_whole_and_without_its_parts() -> None:
    assert list(methods())[1] == JUDGED
    names = [JUDGED, *(f"{JUDGED} without {part}" for part in PARTS)]
    found = attempt(named("scalar bias:20 6 fixed"), SEED, names)
    errors = {name: found[name].rows[0][0] for name in names}
    assert errors["secure without reuse"] > 1.2 * errors[JUDGED]  # liars are a third of the information
    assert variant("secure without merit") is None


def test_settings_stand_after_the_name() -> None:
    names = ["innovation-mixture", "innovation-mixture:memory=sticky;kappa=5.0", "innovation-mixture sticky"]
    plain, told, sticky = (attempt(named("chen drift:.3 2 fixed"), SEED, [name])[name] for name in names)
    assert told.rows[0][:6] == sticky.rows[0][:6] != plain.rows[0][:6]
    assert variant("no such method:kappa=5.0") is None


def test_ratios_are_of_the_same_runs() -> None:
    ratio, error = relative(np.array([2.0, 4.0]), np.array([1.0, 2.0, 90.0]))
    assert (ratio, error) == (2.0, 0.0)
    rows = {"oracle": [1.0, 1.0], "a": [2.0, 2.0], "b": [4.0, 4.0], "c": [1.0, 9.0]}
    results = {name: Result([[value, *[0.0] * 14] for value in mse]) for name, mse in rows.items()}
    assert against_best(results, "b") == (2.0, 0.0, "a")


def test_the_sum_over_sets_is_that_of_brute_force() -> None:
    rng = np.random.default_rng(SEED)
    f, g, law = rng.normal(size=(3, 5)), rng.normal(size=(3, 5)), np.array([0.1, 0.6, 0.3])
    total = np.zeros(5)
    for size, chance in enumerate(law):
        for liars in combinations(range(3), size):
            each = [g[i] if i in liars else f[i] for i in range(3)]
            total += chance / comb(3, size) * np.exp(np.sum(each, axis=0))
    np.testing.assert_allclose(sets(f, g, law), np.log(total), rtol=1e-12)


def test_a_step_of_the_limit_is_the_mixture_of_gaussians_of_brute_force() -> None:
    one = named("scalar bias:5 3 dynamic")
    bayes = _Bayes(one, episode(one, SEED), "moments")
    bayes.C, bayes.R, bayes.law = bayes.C[:3], bayes.R[:3], np.array([0.0, 0.5, 0.5])
    bayes.y = bayes.y[:, :3]
    k, mean, variance = CLEAN + 4, 0.3, 0.8
    found = bayes._update(gaussian(mean, variance), k)
    weights, means, seconds = [], [], []
    for size in (1, 2):
        for liars in combinations(range(3), size):
            r = bayes.y[k] - bayes.C * mean - 5.0 * np.isin(range(3), liars)
            S = variance * np.outer(bayes.C, bayes.C) + np.diag(bayes.R)
            K = variance * np.linalg.solve(S, bayes.C)
            weights.append(0.5 / comb(3, size) * np.exp(-0.5 * r @ np.linalg.solve(S, r)))
            means.append(mean + K @ r)
            seconds.append(variance - K @ bayes.C * variance + means[-1] ** 2)
    weights = np.array(weights) / np.sum(weights)
    assert found.mean == pytest.approx(weights @ means, rel=1e-9)
    assert found.variance == pytest.approx(weights @ seconds - (weights @ means) ** 2, rel=1e-7)


def test_nobody_beats_the_limit() -> None:
    one = named("scalar 26f 3 dynamic")
    assert one in CELLS_WITH_LIMIT
    seeds = range(4)
    best = np.mean([limit(one, seed, "density") for seed in seeds])
    others = [attempt(one, seed, ["innovation-mixture", "kalman"]) for seed in seeds]
    for name in ("innovation-mixture", "kalman"):
        assert best < np.mean([each[name].rows[0][0] for each in others])
