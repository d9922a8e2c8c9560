use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

/// A learning rate with linear warm-up, then half a cosine down to a floor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Schedule {
    /// Highest rate, at the end of the warm-up.
    pub peak: f64,
    /// Steps of the warm-up.
    pub warm_up_steps: u64,
    /// Steps of the whole run.
    pub total_steps: u64,
    /// Rate of the last step as a fraction of the peak (the paper: 0.7).
    pub floor: f64,
}

impl Schedule {
    /// See the fields.
    #[must_use]
    pub fn new(peak: f64, warm_up_steps: u64, total_steps: u64, floor: f64) -> Self {
        Self {
            peak,
            warm_up_steps,
            total_steps,
            floor,
        }
    }

    /// Rate of step `step`, from 0; the floor after the last step.
    #[must_use]
    pub fn at(&self, step: u64) -> f64 {
        if step < self.warm_up_steps {
            return self.peak * (step + 1) as f64 / self.warm_up_steps as f64;
        }
        let cosine_steps = self.total_steps.saturating_sub(self.warm_up_steps).max(1);
        let progress = ((step - self.warm_up_steps) as f64 / cosine_steps as f64).min(1.0);
        self.peak * (self.floor + (1.0 - self.floor) * 0.5 * (1.0 + (PI * progress).cos()))
    }
}

#[cfg(test)]
mod tests {
    use super::Schedule;

    #[test]
    fn rate_rises_then_falls_to_the_floor() {
        let schedule = Schedule::new(1.0, 10, 110, 0.1);
        assert!((schedule.at(0) - 0.1).abs() < 1e-12);
        assert!((schedule.at(9) - 1.0).abs() < 1e-12);
        assert!((schedule.at(10) - 1.0).abs() < 1e-12);
        assert!((schedule.at(60) - 0.55).abs() < 1e-12);
        assert!((schedule.at(110) - 0.1).abs() < 1e-12);
        assert!((schedule.at(1000) - 0.1).abs() < 1e-12);
    }

    #[test]
    fn zero_warm_up_and_length_are_valid() {
        assert_eq!(Schedule::new(1.0, 0, 0, 0.5).at(0), 1.0);
        assert_eq!(Schedule::new(1.0, 0, 0, 0.5).at(5), 0.5);
    }
}
