//! What is known of a sensor before its sample is seen: how it behaved lately.
//!
//! ```text
//!     doubt     p = (1 + a) / (5 + a + b) in [.02, .9],   a ← φ a + (1 − γ),  b ← φ b + γ
//!     rate      the same with the belief that the sample would have had with p = 1/10: past doubt does not
//!               feed on itself
//!     sticky    a two-state chain with rates of beginning and ending to lie, for all sensors and for this one
//! ```

use crate::Result;
use crate::codec::{Decoder, Encoder};
use crate::mixture::labels::Prior;
use crate::mixture::sample::Sample;
use crate::mixture::settings::{Memory, Settings};

/// Pseudo-observations before the first sample: attacked, honest.
const BETA: (f64, f64) = (1.0, 4.0);

/// Odds of an attack by which a sample is remembered, whatever is remembered already.
const ODDS: f64 = 1.0 / 9.0;

/// The same of a sensor that was honest, and of one that was attacked.
const BEGIN: (f64, f64) = (0.2, 1.0);
const STAY: (f64, f64) = (1.0, 2.0);

/// Weight of what all sensors do in the rates of one.
const SHARED: f64 = 8.0;

/// Beliefs of the past.
#[derive(Debug, Clone)]
pub struct Past {
    /// a, b and for the chain the belief that it lied, by sensor: (3, N).
    rates: Vec<f64>,
    /// Transitions honest → honest, honest → attacked, attacked → honest, attacked → attacked: (4, N).
    moves: Vec<f64>,
    /// Averages of standardised residuals, by channel.
    pub drift: Vec<f64>,
}

impl Past {
    /// Before the first sample.
    #[must_use]
    pub fn new(sensors: usize, channels: usize) -> Self {
        Self { rates: vec![0.0; 3 * sensors], moves: vec![0.0; 4 * sensors], drift: vec![0.0; channels] }
    }

    fn sensors(&self) -> usize {
        self.rates.len() / 3
    }

    /// Rates of the chain that all sensors share: to begin, and to go on.
    fn shared(&self) -> (f64, f64) {
        let n = self.sensors();
        let total = |row: usize| self.moves[row * n..(row + 1) * n].iter().sum::<f64>();
        let (begin, stay) = ((total(0), total(1)), (total(2), total(3)));
        ((BEGIN.0 + begin.1) / (BEGIN.1 + begin.0 + begin.1), (STAY.0 + stay.1) / (STAY.1 + stay.0 + stay.1))
    }

    /// Probability that each sensor which arrived is attacked.
    #[inline(always)]
    pub fn expect(&self, settings: &Settings, sample: &Sample, prior: &mut Prior) {
        let n = self.sensors();
        let shared = if settings.memory == Memory::Sticky { self.shared() } else { (0.0, 0.0) };
        for (one, p) in sample.arrived.iter().zip(&mut prior.attacked) {
            let i = one.sensor;
            *p = match settings.memory {
                Memory::Rate | Memory::Doubt => {
                    let (a, b) = (self.rates[i], self.rates[n + i]);
                    ((BETA.0 + a) / (BETA.0 + BETA.1 + a + b)).clamp(0.02, 0.9)
                }
                Memory::Sticky => self.chain(i, shared).clamp(0.002, 0.995),
            };
        }
    }

    fn chain(&self, i: usize, (begin, stay): (f64, f64)) -> f64 {
        let n = self.sensors();
        let count = |row: usize| self.moves[row * n + i];
        let lied = self.rates[2 * n + i];
        let goes_on = (SHARED * stay + count(3)) / (SHARED + count(2) + count(3));
        let begins = (SHARED * begin + count(1)) / (SHARED + count(0) + count(1));
        lied * goes_on + (1.0 - lied) * begins
    }

    /// Remember the beliefs `gamma` of the sensors that arrived, formed with `prior`. What the others did fades.
    #[inline(always)]
    pub fn remember(&mut self, settings: &Settings, sample: &Sample, prior: &Prior, gamma: &[f64]) {
        let (n, forgetting) = (self.sensors(), settings.forgetting);
        self.rates[..2 * n].iter_mut().for_each(|rate| *rate *= forgetting);
        if settings.memory == Memory::Sticky {
            self.remember_moves(sample, gamma, forgetting);
        }
        for ((one, &gamma), p) in sample.arrived.iter().zip(gamma).zip(&prior.attacked) {
            let honest = match settings.memory {
                Memory::Rate => gamma / (gamma + (1.0 - gamma) * (1.0 - p) / p * ODDS),
                _ => gamma,
            };
            self.rates[one.sensor] += 1.0 - honest;
            self.rates[n + one.sensor] += honest;
        }
    }

    fn remember_moves(&mut self, sample: &Sample, gamma: &[f64], forgetting: f64) {
        let (n, (begin, stay)) = (self.sensors(), self.shared());
        self.moves.iter_mut().for_each(|count| *count *= forgetting);
        let mut next = sample.arrived.iter().zip(gamma).peekable();
        for i in 0..n {
            let lied = self.rates[2 * n + i];
            let expected = lied * stay + (1.0 - lied) * begin;
            let Some((_, &honest)) = next.next_if(|(one, _)| one.sensor == i) else {
                self.rates[2 * n + i] = expected;
                continue;
            };
            let lies = 1.0 - honest;
            let moves = [
                honest * (1.0 - lied) * (1.0 - begin) / (1.0 - expected),
                lies * (1.0 - lied) * begin / expected,
                honest * lied * (1.0 - stay) / (1.0 - expected),
                lies * lied * stay / expected,
            ];
            moves.iter().enumerate().for_each(|(row, share)| self.moves[row * n + i] += share);
            self.rates[2 * n + i] = lies;
        }
    }

    /// Write everything.
    pub fn save(&self, to: &mut Encoder) {
        to.floats(&self.rates);
        to.floats(&self.moves);
        to.floats(&self.drift);
    }

    /// Read it back.
    ///
    /// # Errors
    /// [`crate::Error::Resume`] if the bytes do not fit.
    pub fn load(&mut self, from: &mut Decoder<'_>) -> Result<()> {
        for numbers in [&mut self.rates, &mut self.moves, &mut self.drift] {
            from.floats(numbers)?;
        }
        Ok(())
    }
}
