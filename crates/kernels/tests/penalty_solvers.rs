//! Both solvers reach the optimum: the exact duality gap says so, on regular, singular and free problems alike.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use securestate_kernels::linalg::dot;
use securestate_kernels::penalty::{Problem, SOLVED};
use securestate_kernels::{group_lasso, lasso};

/// A problem that owns its data.
#[derive(Debug, Clone)]
struct Case {
    hessian: Vec<f64>,
    linear: Vec<f64>,
    starts: Vec<usize>,
    gamma: Vec<f64>,
    energy: f64,
}

impl Case {
    fn problem(&self) -> Problem<'_> {
        Problem {
            hessian: &self.hessian,
            linear: &self.linear,
            starts: &self.starts,
            gamma: &self.gamma,
            energy: self.energy,
        }
    }

    fn gap(&self, g: &[f64]) -> f64 {
        let mut nu = vec![0.0; g.len()];
        self.problem().residual(g, &mut nu);
        self.problem().relative_gap(g, &nu)
    }
}

/// H = YᵀY with `rank` rows, ν₀ = −H ζ: the shape of the reduced problem, singular when rank < d.
fn case(groups: usize, width: usize, rank: usize, numbers: &[f64], zeta_scale: f64, gamma: f64) -> Case {
    let d = groups * width;
    let entry = |r: usize, c: usize| numbers[(r * d + c) % numbers.len()];
    let mut y: Vec<Vec<f64>> = (0..d).map(|c| (0..rank).map(|r| entry(r, c)).collect()).collect();
    orthogonal_within_groups(&mut y, width);
    let mut hessian = vec![0.0; d * d];
    for i in 0..d {
        for j in 0..d {
            let cross = i / width == j / width && i != j;
            hessian[i * d + j] = if cross { 0.0 } else { dot(&y[i], &y[j]) };
        }
    }
    let zeta: Vec<f64> = (0..d).map(|i| zeta_scale * numbers[(7 * i + 3) % numbers.len()]).collect();
    let linear: Vec<f64> = (0..d).map(|i| -dot(&hessian[i * d..(i + 1) * d], &zeta)).collect();
    let energy = -dot(&zeta, &linear);
    Case {
        hessian,
        linear,
        starts: (0..=groups).map(|j| j * width).collect(),
        gamma: vec![gamma; groups],
        energy,
    }
}

/// Gram–Schmidt inside every group, so that the diagonal blocks of H are diagonal.
fn orthogonal_within_groups(y: &mut [Vec<f64>], width: usize) {
    for group in y.chunks_mut(width) {
        for i in 0..group.len() {
            let (done, rest) = group.split_at_mut(i);
            for other in done {
                let size = dot(other, other);
                let share = if size > 1e-12 { dot(&rest[0], other) / size } else { 0.0 };
                rest[0].iter_mut().zip(other.iter()).for_each(|(a, b)| *a -= share * b);
            }
        }
    }
}

fn solve_elements(case: &Case, g: &mut [f64]) -> f64 {
    lasso::solve(&case.problem(), g, &mut lasso::Workspace::new(g.len())).gap
}

fn solve_groups(case: &Case, g: &mut [f64]) -> f64 {
    let mut workspace = group_lasso::Workspace::new(g.len(), case.gamma.len());
    group_lasso::solve(&case.problem(), g, &mut workspace).gap
}

fn numbers() -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(-1.0..1.0_f64, 101)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn the_lasso_is_solved_to_its_exact_gap(
        numbers in numbers(), d in 1..25_usize, rank in 1..25_usize, size in -1..4_i32, gamma in 0.01..3.0_f64,
    ) {
        let case = case(d, 1, rank, &numbers, 10_f64.powi(size), gamma);
        let mut g = vec![0.0; d];
        let reported = solve_elements(&case, &mut g);
        prop_assert!(reported <= SOLVED, "reported {reported:e}");
        prop_assert!(case.gap(&g) <= SOLVED);
    }

    #[test]
    fn the_group_lasso_is_solved_to_its_exact_gap(
        numbers in numbers(), groups in 1..9_usize, width in 1..5_usize, spare in 1..6_usize,
        size in -1..4_i32, gamma in 0.01..3.0_f64,
    ) {
        let case = case(groups, width, width + spare, &numbers, 10_f64.powi(size), gamma);
        let mut g = vec![0.0; groups * width];
        let reported = solve_groups(&case, &mut g);
        prop_assert!(reported <= SOLVED, "reported {reported:e}");
        prop_assert!(case.gap(&g) <= SOLVED);
    }

    #[test]
    fn groups_of_one_element_are_a_lasso(numbers in numbers(), d in 1..12_usize, gamma in 0.1..3.0_f64) {
        let case = case(d, 1, d + 3, &numbers, 10.0, gamma);
        let (mut by_elements, mut by_groups) = (vec![0.0; d], vec![0.0; d]);
        solve_elements(&case, &mut by_elements);
        solve_groups(&case, &mut by_groups);
        for (a, b) in by_elements.iter().zip(&by_groups) {
            prop_assert!((a - b).abs() <= 1e-6 * (1.0 + a.abs()), "{a} {b}");
        }
    }

    #[test]
    fn a_warm_start_changes_the_road_and_not_the_end(
        numbers in numbers(), start in prop::collection::vec(-5.0..5.0_f64, 12), gamma in 0.1..2.0_f64,
    ) {
        let case = case(4, 3, 16, &numbers, 20.0, gamma);
        let (mut cold, mut warm) = (vec![0.0; 12], start);
        solve_groups(&case, &mut cold);
        solve_groups(&case, &mut warm);
        for (a, b) in cold.iter().zip(&warm) {
            prop_assert!((a - b).abs() <= 1e-6 * (1.0 + a.abs()), "{a} {b}");
        }
    }

    #[test]
    fn a_free_group_ends_with_nothing_left_to_explain(
        numbers in numbers(), free in 0..4_usize, size in 0..5_i32, gamma in 0.1..2.0_f64,
    ) {
        let mut case = case(4, 2, 12, &numbers, 10_f64.powi(size), gamma);
        case.gamma[free] = 0.0;
        let mut g = vec![0.0; 8];
        prop_assert!(solve_groups(&case, &mut g) <= SOLVED);
        let mut nu = vec![0.0; 8];
        case.problem().residual(&g, &mut nu);
        let left = nu[2 * free..2 * free + 2].iter().fold(0.0_f64, |a, v| a.max(v.abs()));
        prop_assert!(left <= 1e-8 * 10_f64.powi(size), "{left:e}");
    }
}

#[test]
fn zero_is_optimal_exactly_when_the_dual_norms_are_within_their_bounds() {
    let mut case = case(3, 1, 5, &[0.5, -0.2, 0.9, 0.1, -0.7], 1.0, 1.0);
    let largest = case.linear.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
    case.gamma = vec![largest; 3];
    assert!(case.problem().zero_is_optimal());
    case.gamma = vec![largest * (1.0 - 1e-12); 3];
    assert!(!case.problem().zero_is_optimal());
}

#[test]
fn the_gap_of_a_wrong_answer_is_large() {
    let case = case(3, 1, 5, &[0.5, -0.2, 0.9, 0.1, -0.7], 10.0, 0.1);
    assert!(case.gap(&[0.0; 3]) > 1e-3);
    assert!(case.gap(&[1.0, -1.0, 1.0]) > 1e-3);
}

#[test]
fn two_channels_that_say_the_same_are_no_obstacle() {
    let hessian = vec![1.0, 1.0, 1.0, 1.0];
    let case =
        Case { hessian, linear: vec![5.0, 5.0], starts: vec![0, 1, 2], gamma: vec![1.0; 2], energy: 25.0 };
    let mut g = vec![2.0, 3.5];
    assert!(solve_elements(&case, &mut g) <= SOLVED);
    assert!((g[0] + g[1] - 4.0).abs() < 1e-12);
}
