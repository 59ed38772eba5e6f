//! What one sample says before anybody is judged: who arrived, and how far everyone is from the prediction.

use crate::kalman::heard::Heard;
use crate::linalg::{cholesky, dot, forward_solve};
use crate::mixture::information::Information;

/// Whitened innovations further off than this many standard deviations are taken to be this far off.
const FURTHEST: f64 = 1e6;

/// The same for sensors that nobody can tamper with: as far as squares can be computed.
const LARGEST: f64 = 1e150;

/// A sensor of which something arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrived {
    /// Which.
    pub sensor: usize,
    /// Its first whitened channel.
    pub first: usize,
    /// How many of its channels arrived.
    pub size: usize,
    /// Where its block of size² numbers begins.
    pub block: usize,
    /// Nobody can tamper with it.
    pub protected: bool,
}

/// One sample about the prediction N(C x⁻, S), S_i = C_i P⁻ C_iᵀ + R_i.
#[derive(Debug, Clone)]
pub struct Sample {
    /// Who arrived, in order.
    pub arrived: Vec<Arrived>,
    /// Whitened innovation of every channel, L_i⁻¹ r_i with R_i = L_i L_iᵀ, not further off than [`FURTHEST`].
    pub residual: Vec<f64>,
    /// S_i^-½ r_i, by channel.
    pub surprise: Vec<f64>,
    /// |S_i^-½ r_i|², by sensor that arrived.
    pub square: Vec<f64>,
    /// log det of the whitened S_i, by sensor that arrived.
    pub log_det: Vec<f64>,
    /// Diagonal of the whitened S, by channel.
    pub variance: Vec<f64>,
    /// Most channels that a sensor has here.
    pub widest: usize,
    factor: Vec<f64>,
}

impl Sample {
    /// Room for the channels of a plant.
    #[must_use]
    pub fn new(channels: usize, sensors: usize) -> Self {
        Self {
            arrived: Vec::with_capacity(sensors),
            residual: vec![0.0; channels],
            surprise: vec![0.0; channels],
            square: vec![0.0; sensors],
            log_det: vec![0.0; sensors],
            variance: vec![0.0; channels],
            widest: 0,
            factor: vec![0.0; channels * channels],
        }
    }

    /// Note who arrived. `owner` is that of every channel of the plant, `protected` by sensor.
    pub fn listen(&mut self, heard: &Heard, owner: &[usize], protected: &[bool]) {
        self.arrived.clear();
        for (place, &channel) in heard.channels().iter().enumerate() {
            let sensor = owner[channel];
            match self.arrived.last_mut() {
                Some(last) if last.sensor == sensor => last.size += 1,
                last => {
                    let block = last.map_or(0, |last| last.block + last.size * last.size);
                    let protected = protected[sensor];
                    self.arrived.push(Arrived { sensor, first: place, size: 1, block, protected });
                }
            }
        }
        self.widest = self.arrived.iter().map(|one| one.size).max().unwrap_or(0);
    }

    /// Measure everyone against the prediction; `residual` holds the whitened innovations.
    #[inline(always)]
    pub fn measure(&mut self, information: &Information) {
        for index in 0..self.arrived.len() {
            let one = self.arrived[index];
            if one.size == 1 {
                let z = information.z(one.first);
                let variance = 1.0 + dot(z, z);
                let deviation = variance.sqrt();
                let furthest = if one.protected { LARGEST } else { FURTHEST * deviation };
                // Not `clamp`, which panics where P⁻ overflows.
                let residual = self.residual[one.first].max(-furthest).min(furthest);
                let surprise = residual / deviation;
                self.residual[one.first] = residual;
                self.surprise[one.first] = surprise;
                self.square[index] = surprise * surprise;
                self.variance[one.first] = variance;
                self.log_det[index] = variance.ln();
            } else {
                self.measure_jointly(information, index);
            }
        }
    }

    fn measure_jointly(&mut self, information: &Information, index: usize) {
        let Arrived { first, size, protected, .. } = self.arrived[index];
        for a in 0..size {
            for b in 0..=a {
                let unit = f64::from(u8::from(a == b));
                self.factor[a * size + b] = dot(information.z(first + a), information.z(first + b)) + unit;
            }
            self.variance[first + a] = self.factor[a * size + a];
        }
        // S is at least the identity: its Cholesky factor exists unless P⁻ overflows.
        let _ = cholesky(&mut self.factor, size, size, 0.0);
        let (residual, surprise) = (&mut self.residual[first..], &mut self.surprise[first..first + size]);
        let largest = f64::MAX.sqrt() / FURTHEST;
        for value in &mut residual[..size] {
            *value = if value.is_nan() { largest } else { value.clamp(-largest, largest) };
        }
        surprise.copy_from_slice(&residual[..size]);
        forward_solve(&self.factor, size, surprise);
        let excess = (dot(surprise, surprise) / size as f64).sqrt() / FURTHEST;
        if excess > 1.0 && !protected {
            residual[..size].iter_mut().chain(surprise.iter_mut()).for_each(|value| *value /= excess);
        }
        self.square[index] = dot(surprise, surprise);
        self.log_det[index] = 2.0 * (0..size).map(|a| self.factor[a * size + a].ln()).sum::<f64>();
    }
}
