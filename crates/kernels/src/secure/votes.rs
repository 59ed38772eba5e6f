//! Whether the accused are too many to be the liars.
//!
//! They are if they are no minority; a sensor alone with what it sees is not counted, because nobody speaks against it but
//! the prediction. They also are if, of the sensors that see the state along the same line, more are accused
//! than all that are believed see of that line, the prediction counting as one:
//!
//! ```text
//!     k zᵀ (I + T)⁻¹ z > 1
//! ```
//!
//! z is the unit vector (in units of P⁻) along which k accused sensors see the state, T the sum of z zᵀ over the channels
//! of those who are believed. Sensors that see different combinations of states are not counted together: few believed
//! ones may know more than many accused.

use crate::linalg::dot;
use crate::mixture::information::Information;
use crate::mixture::sample::{Arrived, Sample};
use crate::secure::Work;
use crate::secure::labels::Labels;
use crate::secure::settings::{Part, Settings};

/// Cosine from which on two sensors see the same.
const SAME: f64 = 1.0 - 1e-6;

/// Rounding by which as many accused as believed may look like more.
const ROUNDING: f64 = 1e-9;

/// Accused sensors that see the same from which on they may be too many: two may be two liars.
const FEW: usize = 3;

/// Votes of a protected sensor, as a root.
const PROTECTED: f64 = 1e3;

/// Whether the labelling `winner` accuses more than it believes.
#[inline(always)]
pub(super) fn outvoted(work: &mut Work, settings: &Settings, winner: usize) -> bool {
    let Work { sample, information, trials, .. } = work;
    let labels = &trials[winner];
    if channels(sample, labels, false).next().is_none() {
        return false;
    }
    information.clear();
    for (channel, protected) in channels(sample, labels, true) {
        let factor = unit(information, channel) * if protected { PROTECTED } else { 1.0 };
        information.weigh(factor, channel);
    }
    information.update();
    let mut heads = 0;
    for one in accused(sample, labels) {
        let (mut counts, mut many) = (false, false);
        for channel in one.first..one.first + one.size {
            let length = unit(information, channel);
            let alike =
                accused(sample, labels).filter(|other| sees_the_same(information, channel, other)).count();
            let open = length * length * information.w_t().map(|w| w[channel] * w[channel]).sum::<f64>();
            counts |= alike > 1 || open < 1.0 - ROUNDING;
            many |= alike >= FEW && alike as f64 * open > 1.0 + ROUNDING;
        }
        if many && settings.has(Part::Votes) {
            return true;
        }
        heads += usize::from(counts);
    }
    heads > settings.most(sample)
}

/// Whether a sensor sees the state along the line of a channel.
#[inline(always)]
fn sees_the_same(information: &Information, channel: usize, other: &Arrived) -> bool {
    let (z, length) = (information.z(channel), unit(information, channel));
    (other.first..other.first + other.size).any(|own| {
        let cosine = length * unit(information, own) * dot(z, information.z(own));
        cosine.abs() > SAME
    })
}

/// The sensors that are not believed.
#[inline(always)]
fn accused<'a>(sample: &'a Sample, labels: &'a Labels) -> impl Iterator<Item = &'a Arrived> {
    sample.arrived.iter().enumerate().filter(|(index, _)| !labels.believes(*index)).map(|(_, one)| one)
}

/// Channels of the sensors that are believed, or of those that are not, and whether they are protected.
#[inline(always)]
fn channels<'a>(
    sample: &'a Sample,
    labels: &'a Labels,
    believed: bool,
) -> impl Iterator<Item = (usize, bool)> + 'a {
    let chosen =
        sample.arrived.iter().enumerate().filter(move |(index, _)| labels.believes(*index) == believed);
    chosen.flat_map(|(_, one)| (one.first..one.first + one.size).map(|channel| (channel, one.protected)))
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
