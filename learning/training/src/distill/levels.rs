use anyhow::{Result, ensure};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use wm_model::sampler::Sampler;

/// Levels closer than this are equal: both samplers compute theirs alike, but from other fractions.
const SAME: f64 = 1e-9;

/// Three noise levels: the teacher steps from the first to the second, and the student from either to the third.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rung {
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) end: f64,
}

/// Noise levels of a distillation: the teacher's, including the student's.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Levels(Vec<Rung>);

impl Levels {
    /// From two samplers of equal shift.
    ///
    /// # Errors
    /// If the student does not take fewer steps than the teacher.
    pub(super) fn new(teacher: &Sampler, student: &Sampler) -> Result<Self> {
        ensure!(
            (1..teacher.steps).contains(&student.steps),
            "steps is {}, expected at least 1 and fewer than the teacher's {}",
            student.steps,
            teacher.steps
        );
        let ends = student.levels();
        let mut levels = [teacher.levels(), ends.clone()].concat();
        levels.sort_by(|a, b| b.total_cmp(a));
        levels.dedup_by(|a, b| (*a - *b).abs() < SAME);
        let pairs = levels.iter().zip(levels.iter().skip(1));
        let rungs = pairs.map(|(from, to)| {
            let below = ends.iter().find(|end| **end < *from - SAME);
            Rung {
                from: *from,
                to: *to,
                // The student's last level is 0.
                end: below.copied().unwrap_or(0.0),
            }
        });
        Ok(Self(rungs.collect()))
    }

    /// A uniformly random entry.
    pub(super) fn draw(&self, rng: &mut ChaCha8Rng) -> Result<Rung> {
        let rung = self.0.get(rng.random_range(0..self.0.len().max(1)));
        rung.copied().ok_or_else(|| anyhow::anyhow!("no levels"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn levels(teacher: usize, student: usize) -> Result<Levels> {
        let of = |steps| Sampler {
            steps,
            shift: 3.0,
            context_tau: 0.0,
        };
        Levels::new(&of(teacher), &of(student))
    }

    #[test]
    fn two_step_student_ends_at_the_middle_and_zero() {
        let Levels(rungs) = levels(4, 2).unwrap();
        let found: Vec<[f64; 3]> = rungs
            .iter()
            .map(|rung| [rung.from, rung.to, rung.end])
            .collect();
        // 3 t / (1 + 2 t) of 1, 3/4, 1/2, 1/4 and 0.
        let expected = [
            [1.0, 0.9, 0.75],
            [0.9, 0.75, 0.75],
            [0.75, 0.5, 0.0],
            [0.5, 0.0, 0.0],
        ];
        for (found, expected) in found.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 1e-12, "{rungs:?}");
        }
        assert_eq!(found.len(), 4);
    }

    #[test]
    fn missing_student_level_is_added() {
        let Levels(rungs) = levels(3, 2).unwrap();
        assert_eq!(rungs.len(), 4);
        assert!(
            rungs
                .iter()
                .any(|rung| rung.to == rung.end && rung.end > 0.0)
        );
    }

    #[test]
    fn student_needs_fewer_steps_than_the_teacher() {
        for steps in [0, 10, 11] {
            let error = levels(10, steps).unwrap_err().to_string();
            assert!(error.contains("the teacher's 10"), "{error}");
        }
    }
}
