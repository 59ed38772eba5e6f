//! Who is named: the sensor far ahead of all others, at several samples in a row.

/// What it takes to be named.
#[derive(Debug, Clone)]
pub struct Law {
    /// Ratio above which something is wrong.
    pub limit: f64,
    /// What the winner must be ahead of the runner-up.
    pub margin: f64,
    /// Samples in a row.
    pub persist: usize,
    /// What the limit rises by while another sensor is biased.
    pub further: f64,
    /// Sensors that nobody can vouch for: never named, (N,).
    pub uncheckable: Vec<bool>,
}

/// The sensor with the largest ratio.
#[derive(Debug, Clone, Copy)]
pub struct Lead {
    /// The sensor.
    pub sensor: usize,
    /// Its channel.
    pub channel: usize,
    /// Its ratio.
    pub score: f64,
    /// How far the runner-up is behind.
    pub ahead: f64,
}

/// How a sample is judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Nothing is wrong, or the winner must win again first.
    Quiet,
    /// Something is wrong and it cannot be said with whom.
    Unclear,
    /// The winner is biased.
    Named,
}

/// Wins in a row.
#[derive(Debug, Clone, Default)]
pub struct Streak {
    /// Who won last.
    pub sensor: usize,
    /// How often in a row.
    pub wins: usize,
}

impl Streak {
    /// Judge the sample's leader; `biased` says that another sensor is known to be biased, `room` that one more step
    /// can be kept.
    pub fn judge(&mut self, law: &Law, lead: Lead, biased: bool, room: bool) -> Verdict {
        let limit = law.limit + if biased { law.further } else { 0.0 };
        if lead.score.is_nan() || lead.score <= limit {
            self.wins = 0;
            return Verdict::Quiet;
        }
        if lead.ahead <= law.margin || law.uncheckable[lead.sensor] || !room {
            self.wins = 0;
            return Verdict::Unclear;
        }
        self.wins = if self.sensor == lead.sensor { self.wins + 1 } else { 1 };
        self.sensor = lead.sensor;
        if self.wins < law.persist {
            return Verdict::Quiet;
        }
        self.wins = 0;
        Verdict::Named
    }
}

/// Leader and runner-up among sensors; `scores` is per channel, (≥ m,).
pub fn lead(scores: &[f64], channel_sensor: &[usize]) -> Lead {
    let mut first = Lead { sensor: 0, channel: 0, score: f64::NEG_INFINITY, ahead: f64::INFINITY };
    let mut second = f64::NEG_INFINITY;
    for (channel, (&score, &sensor)) in scores.iter().zip(channel_sensor).enumerate() {
        if score > first.score {
            if sensor != first.sensor {
                second = second.max(first.score);
            }
            first = Lead { sensor, channel, score, ..first };
        } else if sensor != first.sensor {
            second = second.max(score);
        }
    }
    first.ahead = first.score - second;
    first
}

#[cfg(test)]
mod tests {
    use super::*;

    fn law() -> Law {
        Law { limit: 10.0, margin: 4.0, persist: 3, further: 6.0, uncheckable: vec![false, false, true] }
    }

    fn leading(sensor: usize, score: f64, ahead: f64) -> Lead {
        Lead { sensor, channel: sensor, score, ahead }
    }

    #[test]
    fn channels_of_one_sensor_do_not_compete() {
        let found = lead(&[3.0, 9.0, 8.0, 1.0, 7.0], &[0, 1, 1, 1, 2]);
        assert_eq!((found.sensor, found.channel, found.score, found.ahead), (1, 1, 9.0, 2.0));
        assert_eq!(lead(&[5.0, 6.0, 2.0], &[0, 0, 1]).ahead, 4.0);
    }

    #[test]
    fn three_wins_in_a_row_name_and_any_other_sample_starts_anew() {
        let (law, mut streak) = (law(), Streak::default());
        let mut judge = |lead| streak.judge(&law, lead, false, true);
        let (one, other) = (leading(0, 11.0, 5.0), leading(1, 11.0, 5.0));
        let verdicts = [one, one, other, one, one, one, one].map(&mut judge);
        assert_eq!(verdicts[..5], [Verdict::Quiet; 5]);
        assert_eq!(verdicts[5..], [Verdict::Named, Verdict::Quiet]);
        assert_eq!([one, leading(0, 11.0, 3.0), one].map(judge)[1], Verdict::Unclear);
    }

    #[test]
    fn who_cannot_be_checked_or_kept_is_unclear_and_a_further_sensor_needs_more() {
        let (law, mut streak) = (law(), Streak::default());
        assert_eq!(streak.judge(&law, leading(2, 50.0, 30.0), false, true), Verdict::Unclear);
        assert_eq!(streak.judge(&law, leading(0, 50.0, 30.0), false, false), Verdict::Unclear);
        assert_eq!(streak.judge(&law, leading(0, 15.0, 3.0), true, true), Verdict::Quiet);
        assert_eq!(streak.judge(&law, leading(0, 17.0, 3.0), true, true), Verdict::Unclear);
    }
}
