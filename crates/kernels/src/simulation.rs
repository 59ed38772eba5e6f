//! Trajectories of a plant: the one loop over time that a simulation needs.
//!
//! ```text
//!     u[k] = u[k] − L x[k],   y[k] = C x[k] + D u[k] + R^½ v[k],   x[k+1] = A x[k] + B u[k] + Q^½ w[k]
//! ```
//! Nothing is drawn here: the arrays come in with standard normal numbers and go out as trajectories. A run depends
//! on its own numbers only, so threads run across runs.

use rayon::prelude::*;

use crate::kalman::model::Model;
use crate::linalg::add_gemv;
use crate::{Error, Result};

/// What is simulated, in normalised units.
#[derive(Debug)]
pub struct Simulation {
    /// The plant.
    pub model: Model,
    /// Q^½ (n, n), row-major.
    pub root_q: Vec<f64>,
    /// R^½ (m, m), row-major.
    pub root_r: Vec<f64>,
    /// −L (p, n), row-major; empty without feedback.
    pub feedback: Vec<f64>,
}

/// A batch of runs, in place.
#[derive(Debug)]
pub struct Batch<'a> {
    /// Samples per run.
    pub steps: usize,
    /// (runs, steps, n). In: x[0], then w[0], w[1], …; out: x.
    pub x: &'a mut [f64],
    /// (runs, steps, p). In: u without feedback; out: u.
    pub u: &'a mut [f64],
    /// (runs, steps, m). In: v; out: y.
    pub y: &'a mut [f64],
    /// (runs, steps, m). Out: the noise R^½ v in y.
    pub noise: &'a mut [f64],
}

/// One run of a batch.
struct Run<'a> {
    x: &'a mut [f64],
    u: &'a mut [f64],
    y: &'a mut [f64],
    noise: &'a mut [f64],
}

impl Simulation {
    /// Check that the factors fit the plant.
    ///
    /// # Errors
    /// A wrong length.
    pub fn new(model: Model, root_q: Vec<f64>, root_r: Vec<f64>, feedback: Vec<f64>) -> Result<Self> {
        let dims = model.dims;
        Error::check_len("root_q", dims.states * dims.states, root_q.len())?;
        Error::check_len("root_r", dims.channels * dims.channels, root_r.len())?;
        if !feedback.is_empty() {
            Error::check_len("feedback", dims.inputs * dims.states, feedback.len())?;
        }
        Ok(Self { model, root_q, root_r, feedback })
    }

    /// Run every trajectory of a batch.
    ///
    /// # Errors
    /// Arrays that do not hold the same number of runs, or more samples than the plant covers.
    pub fn run(&self, batch: Batch<'_>) -> Result<()> {
        let (dims, steps) = (self.model.dims, batch.steps);
        if let Some(horizon) = self.model.horizon.filter(|&horizon| steps > horizon) {
            let expected = format!("at most {horizon}, as many as A and C cover");
            return Err(Error::input("steps", expected, format!("{steps}")));
        }
        let runs = batch.x.len().checked_div(steps * dims.states).unwrap_or(0);
        Error::check_len("x", runs * steps * dims.states, batch.x.len())?;
        Error::check_len("u", runs * steps * dims.inputs, batch.u.len())?;
        Error::check_len("y", runs * steps * dims.channels, batch.y.len())?;
        Error::check_len("noise", batch.y.len(), batch.noise.len())?;
        let mut parts = (
            shares(batch.x, steps * dims.states),
            shares(batch.u, steps * dims.inputs),
            shares(batch.y, steps * dims.channels),
            shares(batch.noise, steps * dims.channels),
        );
        let runs: Vec<Run<'_>> =
            (0..runs).map(|_| Run { x: parts.0(), u: parts.1(), y: parts.2(), noise: parts.3() }).collect();
        runs.into_par_iter().for_each(|run| self.run_one(run, steps));
        Ok(())
    }

    fn run_one(&self, run: Run<'_>, steps: usize) {
        let (n, p, m) = (self.model.dims.states, self.model.dims.inputs, self.model.dims.channels);
        let mut next = vec![0.0; n];
        for k in 0..steps {
            let (past, future) = run.x.split_at_mut((k + 1) * n);
            let x = &past[k * n..];
            let u = &mut run.u[k * p..(k + 1) * p];
            if !self.feedback.is_empty() {
                add_gemv(&self.feedback, x, u);
            }
            let (y, noise) = (&mut run.y[k * m..(k + 1) * m], &mut run.noise[k * m..(k + 1) * m]);
            noise.fill(0.0);
            add_gemv(&self.root_r, y, noise);
            y.copy_from_slice(noise);
            self.model.observe(k, x, u, y);
            if let Some(w) = future.get_mut(..n) {
                self.model.predict(k, x, u, &mut next);
                add_gemv(&self.root_q, w, &mut next);
                w.copy_from_slice(&next);
            }
        }
    }
}

/// Successive calls hand out `size` numbers each.
fn shares<'a>(data: &'a mut [f64], size: usize) -> impl FnMut() -> &'a mut [f64] {
    let mut rest = data;
    move || {
        let (head, tail) = std::mem::take(&mut rest).split_at_mut(size);
        rest = tail;
        head
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::model::Matrices;

    fn simulation(horizon: usize) -> Simulation {
        let model = Model::new(Matrices {
            a: vec![2.0; horizon],
            b: vec![1.0],
            c: vec![3.0],
            d: vec![0.5],
            q: vec![4.0],
            r: vec![9.0],
            channel_sensor: vec![0],
            sensors: 1,
            states: 1,
        });
        Simulation::new(model.unwrap(), vec![2.0], vec![3.0], vec![-1.5]).unwrap()
    }

    #[test]
    fn a_trajectory_is_what_the_equations_say() {
        let (mut x, mut u) = ([1.0, 0.5, -1.0], [0.1, 0.2, 0.3]);
        let (mut y, mut noise) = ([1.0, 0.0, -1.0], [7.0; 3]);
        let batch = Batch { steps: 3, x: &mut x, u: &mut u, y: &mut y, noise: &mut noise };
        simulation(1).run(batch).unwrap();
        let u0 = 0.1 - 1.5;
        let x1 = 2.0 + u0 + 2.0 * 0.5;
        let u1 = 0.2 - 1.5 * x1;
        let x2 = 2.0 * x1 + u1 - 2.0;
        let u2 = 0.3 - 1.5 * x2;
        let near = |got: &[f64], want: [f64; 3]| got.iter().zip(want).all(|(g, w)| (g - w).abs() < 1e-14);
        assert!(near(&x, [1.0, x1, x2]) && near(&u, [u0, u1, u2]) && near(&noise, [3.0, 0.0, -3.0]));
        assert!(near(&y, [3.0 + 0.5 * u0 + 3.0, 3.0 * x1 + 0.5 * u1, 3.0 * x2 + 0.5 * u2 - 3.0]));
    }

    #[test]
    fn more_samples_than_the_plant_covers_are_refused() {
        let (mut x, mut u, mut y, mut noise) = ([0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3]);
        let batch = Batch { steps: 3, x: &mut x, u: &mut u, y: &mut y, noise: &mut noise };
        assert!(simulation(2).run(batch).is_err());
    }

    #[test]
    fn arrays_of_different_batches_are_refused() {
        let (mut x, mut u, mut y, mut noise) = ([0.0; 6], [0.0; 6], [0.0; 3], [0.0; 3]);
        let batch = Batch { steps: 3, x: &mut x, u: &mut u, y: &mut y, noise: &mut noise };
        assert!(simulation(1).run(batch).is_err());
    }
}
