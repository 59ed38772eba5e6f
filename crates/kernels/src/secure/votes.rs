//! Whether the accused are too many to be the liars.
//!
//! In some direction of the state more sensors are accused than believed, the prediction counting as one: the largest
//! eigenvalue of K (I + T)⁻¹ exceeds 1, K and T the sums of the unit vectors (in units of P⁻) along which the accused
//! and the others see the state. Among sensors of a scalar state this counts heads; among sensors that each see a part of
//! it, it counts those who see the same part.

use crate::linalg::dot;
use crate::mixture::information::Information;
use crate::secure::Work;
use crate::secure::settings::{Part, Settings};

/// Rounds of the power method.
const ROUNDS: usize = 8;

/// Rounding by which as many accused as believed may look like more.
const ROUNDING: f64 = 1e-9;

/// Votes of a protected sensor, as a root.
const PROTECTED: f64 = 1e3;

/// Whether the labelling `winner` accuses more than it believes.
#[inline(always)]
pub(super) fn outvoted(work: &mut Work, settings: &Settings, winner: usize) -> bool {
    let Work { sample, information, trials, direction, .. } = work;
    let labels = &trials[winner];
    let accused = (0..sample.arrived.len()).filter(|&index| !labels.believes(index)).count();
    if accused == 0 || accused > settings.most(sample) {
        return accused > 0;
    }
    if !settings.has(Part::Votes) {
        return false;
    }
    information.clear();
    for (_, one) in sample.arrived.iter().enumerate().filter(|(index, _)| labels.believes(*index)) {
        for channel in one.first..one.first + one.size {
            let factor = if one.protected { PROTECTED } else { unit(information, channel) };
            information.weigh(factor, channel);
        }
    }
    information.update();
    let (v, next) = direction.split_at_mut(information.states());
    v.fill(1.0);
    let mut value = 0.0;
    for _ in 0..ROUNDS {
        let length = dot(v, v).sqrt();
        if length == 0.0 {
            return false;
        }
        v.iter_mut().for_each(|v| *v /= length);
        next.fill(0.0);
        for (_, one) in sample.arrived.iter().enumerate().filter(|(index, _)| !labels.believes(*index)) {
            for channel in one.first..one.first + one.size {
                let factor = unit(information, channel);
                let along: f64 = information.w_t().zip(v.iter()).map(|(w, v)| w[channel] * v).sum();
                for (target, w) in next.iter_mut().zip(information.w_t()) {
                    *target += factor * factor * along * w[channel];
                }
            }
        }
        value = dot(next, next).sqrt();
        v.copy_from_slice(next);
    }
    value > 1.0 + ROUNDING
}

/// Inverse length of a row of Z.
#[inline(always)]
fn unit(information: &Information, channel: usize) -> f64 {
    let z = information.z(channel);
    let square = dot(z, z);
    if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::kalman::model::{Matrices, Model};
    use crate::secure::{Secure, State};
    use crate::{Estimator, Record};

    /// Sensors with these rows of C and R = 1 after a sample of zeros, and what was chosen for them.
    fn heard(rows: &[[f64; 2]], protected: &[usize]) -> (State, Settings) {
        let (m, identity) = (rows.len(), vec![1.0, 0.0, 0.0, 1.0]);
        let matrices = Matrices {
            a: identity.clone(),
            b: vec![],
            c: rows.concat(),
            d: vec![],
            q: identity.clone(),
            r: (0..m * m).map(|k| f64::from(u8::from(k / m == k % m))).collect(),
            channel_sensor: (0..m).collect(),
            sensors: m,
            states: 2,
        };
        let guarded = (0..m).map(|i| protected.contains(&i)).collect();
        let owner: Vec<usize> = (0..m).collect();
        let settings = Settings::new((vec![1e-3; m], 1e-4), guarded, &owner, vec![1.0; m]).unwrap();
        let estimator = Secure::new(Model::new(matrices).unwrap(), None, settings.clone()).unwrap();
        let mut state = estimator.start(&[0.0; 2], Some(&identity)).unwrap();
        let mut record = Record::new(estimator.dims(), estimator.diagnostics().len(), 1, 1, true);
        estimator.step(&mut state, &vec![0.0; m], &[], &mut record.split()[0].at(0)).unwrap();
        (state, settings)
    }

    fn too_many(rows: &[[f64; 2]], protected: &[usize], accused: &[usize]) -> bool {
        let (mut state, settings) = heard(rows, protected);
        for (index, belief) in state.work.trials[0].belief.iter_mut().enumerate() {
            *belief = if accused.contains(&index) { [0.0, 0.0, 0.0, 1.0] } else { [1.0, 0.0, 0.0, 0.0] };
        }
        outvoted(&mut state.work, &settings, 0)
    }

    const X: [f64; 2] = [1.0, 0.0];
    const Y: [f64; 2] = [0.0, 2.0];

    #[test]
    fn among_sensors_of_the_same_state_heads_count_and_the_prediction_is_one() {
        assert!(!too_many(&[X; 5], &[], &[]));
        assert!(!too_many(&[X; 5], &[], &[1]) && !too_many(&[X; 5], &[], &[1, 3]));
        assert!(too_many(&[X; 5], &[], &[0, 1, 2]) && too_many(&[X; 5], &[], &[0, 1, 2, 3, 4]));
        assert!(!too_many(&[X; 4], &[], &[1]) && too_many(&[X; 4], &[], &[1, 2]));
    }

    #[test]
    fn among_sensors_that_see_a_part_those_who_see_the_same_count() {
        let rows = [X, X, X, X, Y, Y, Y, Y, Y];
        assert!(too_many(&rows, &[], &[0, 1, 2]) && !too_many(&rows, &[], &[4, 5]));
        assert!(!too_many(&rows, &[], &[0, 1, 4]) && too_many(&rows, &[], &[4, 5, 6, 7]));
    }

    #[test]
    fn a_protected_sensor_outvotes_everybody_who_sees_the_same() {
        let rows = [X, X, X, X, Y, Y, Y, Y];
        assert!(!too_many(&rows, &[0], &[1, 2, 3]) && too_many(&rows, &[0], &[4, 5, 6]));
    }

    #[test]
    fn a_direction_in_which_states_cancel_is_found() {
        let (along, across) = ([1.0, 1.0], [1.0, -1.0]);
        let rows = [along, along, along, along, across, across, across, across];
        assert!(too_many(&rows, &[], &[1, 2, 3]) && too_many(&rows, &[], &[5, 6, 7]));
    }

    #[test]
    fn as_many_as_are_believed_are_not_more() {
        for believed in 2..6 {
            let rows = [vec![X; 2 * believed + 1], vec![Y; 2 * believed + 1]].concat();
            let accused: Vec<usize> = (0..believed + 2).collect();
            assert!(!too_many(&rows, &[], &accused[1..]) && too_many(&rows, &[], &accused), "{believed}");
        }
    }
}
