//! The gate: the student must match its teacher on held-out episodes.

use std::fmt;

use anyhow::{Result, bail};
use rayon::prelude::*;
use serde::Serialize;
use wm_evaluation::{ActionChange, Windows, on_predicted, recover_actions, squared};
use wm_model::transition::LoadedTransition;
use wm_motion::actions::ActionEncoding;
use wm_zoo::idm::TrainedIdm;

use super::recipe::GateRecipe;

/// Figures of a model.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Figures {
    /// Number of Euler steps.
    steps: usize,
    /// Squared latent error over that of persistence, by predicted step.
    pub(super) ratios: Vec<f64>,
    /// Squared change between predictions, relative to the true change.
    pub(super) motion: f64,
    /// Distance of one-step plans to the true actions relative to random ones, mean of translation and rotation.
    cem: Option<f64>,
    /// Mean correlation of true actions with those inferred from predictions.
    idm: Option<f64>,
}

/// Inputs of a measurement.
pub(super) struct Measurement<'a> {
    pub(super) evaluation: &'a Windows,
    pub(super) encoding: &'a ActionEncoding,
    pub(super) idm: Option<&'a TrainedIdm>,
    /// Number of plans.
    pub(super) plans: usize,
}

impl Measurement<'_> {
    pub(super) fn of(&self, model: &LoadedTransition) -> Result<Figures> {
        let windows = (0..self.evaluation.len())
            .into_par_iter()
            .map(|window| self.errors(window, model))
            .collect::<Result<Vec<_>>>()?;
        let mut sums: Vec<[f64; 4]> = Vec::new();
        for steps in windows {
            sums.resize(steps.len(), [0.0; 4]);
            for (sum, step) in sums.iter_mut().flatten().zip(steps.into_iter().flatten()) {
                *sum += step;
            }
        }
        let [moved, to_move] = sums.iter().fold([0.0; 2], |[moved, to_move], sum| {
            [moved + sum[2], to_move + sum[3]]
        });
        let cem = match self.plans {
            0 => None,
            plans => {
                let found = recover_actions(model, self.encoding, self.evaluation, plans)?;
                let parts = [found.translation, found.rotation];
                Some(
                    parts
                        .map(|[plan, _, random]| plan / random)
                        .iter()
                        .sum::<f64>()
                        / 2.0,
                )
            }
        };
        let correlation = self
            .idm
            .map(|idm| on_predicted(idm, model, self.evaluation));
        Ok(Figures {
            steps: model.config().sampler.steps,
            ratios: sums.iter().map(|sum| sum[0] / sum[1]).collect(),
            motion: moved / to_move,
            cem,
            idm: correlation
                .transpose()?
                .and_then(|found| found.mean(|_| true)),
        })
    }

    /// Squared errors of prediction and persistence, and squared changes of prediction and truth since the previous step, for
    /// each predicted step of a window.
    fn errors(&self, window: usize, model: &LoadedTransition) -> Result<Vec<[f64; 4]>> {
        let sampler = &model.config().sampler;
        let predicted = (self.evaluation).predict(window, model, sampler, ActionChange::None)?;
        let coming = self.evaluation.coming(window)?;
        let last = self.evaluation.last_observed(window)?;
        let (mut before, mut really_before) = (&last, last.clone());
        let mut steps = Vec::new();
        for (k, prediction) in predicted.iter().enumerate() {
            let truth = coming.narrow(0, k, 1)?;
            steps.push([
                squared(prediction, &truth)?,
                squared(&last, &truth)?,
                squared(prediction, before)?,
                squared(&truth, &really_before)?,
            ]);
            (before, really_before) = (prediction, truth);
        }
        Ok(steps)
    }
}

/// Bound of a student's figure relative to the teacher's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Bound {
    /// At most this multiple.
    AtMost(f64),
    /// At least this multiple.
    AtLeast(f64),
    /// Lower by at most this; for correlations, which may be near or below 0.
    LowerBy(f64),
}

impl Bound {
    /// NaN fails every bound.
    fn holds(self, student: f64, teacher: f64) -> bool {
        match self {
            Self::AtMost(factor) => student <= factor * teacher,
            Self::AtLeast(factor) => student >= factor * teacher,
            Self::LowerBy(difference) => student >= teacher - difference,
        }
    }
}

impl fmt::Display for Bound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AtMost(factor) => write!(f, "at most {factor:.2} times the teacher's"),
            Self::AtLeast(factor) => write!(f, "at least {factor:.2} times the teacher's"),
            Self::LowerBy(difference) => write!(f, "at most {difference:.2} below the teacher's"),
        }
    }
}

/// A figure of three models.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Row {
    figure: String,
    student: f64,
    teacher: f64,
    /// Student over teacher.
    ratio: f64,
    /// The teacher with the student's number of steps.
    hurried_teacher: f64,
    /// Bound of the gate; `None` for information only.
    bound: Option<Bound>,
    passes: bool,
}

impl Row {
    fn new(figure: impl Into<String>, of: [f64; 3], bound: Option<Bound>) -> Self {
        let [student, teacher, hurried_teacher] = of;
        Self {
            figure: figure.into(),
            student,
            teacher,
            ratio: student / teacher,
            hurried_teacher,
            bound,
            passes: bound.is_none_or(|bound| bound.holds(student, teacher)),
        }
    }
}

/// Figures of a student and its teacher, and the result of the gate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Verdict {
    /// Number of predicted windows.
    windows: usize,
    student_steps: usize,
    teacher_steps: usize,
    rows: Vec<Row>,
    passes: bool,
}

impl Verdict {
    /// From the student, its teacher, and the teacher with as few steps.
    pub(super) fn new(
        windows: usize,
        [student, teacher, hurried]: &[Figures; 3],
        gate: &GateRecipe,
    ) -> Self {
        let mut rows = Vec::new();
        let last = teacher.ratios.len();
        let ratios = student.ratios.iter().zip(&teacher.ratios);
        for (k, ((a, b), c)) in (1..).zip(ratios.zip(&hurried.ratios)) {
            let bound = (k == last).then_some(Bound::AtMost(gate.ratio));
            rows.push(Row::new(format!("ratio_k{k}"), [*a, *b, *c], bound));
        }
        let of = [student.motion, teacher.motion, hurried.motion];
        rows.push(Row::new("motion", of, Some(Bound::AtLeast(gate.motion))));
        if let (Some(a), Some(b), Some(c)) = (student.cem, teacher.cem, hurried.cem) {
            rows.push(Row::new("cem", [a, b, c], Some(Bound::AtMost(gate.cem))));
        }
        if let (Some(a), Some(b), Some(c)) = (student.idm, teacher.idm, hurried.idm) {
            rows.push(Row::new("idm_r", [a, b, c], Some(Bound::LowerBy(gate.idm))));
        }
        Self {
            windows,
            student_steps: student.steps,
            teacher_steps: teacher.steps,
            passes: rows.iter().all(|row| row.passes),
            rows,
        }
    }

    pub(super) fn passes(&self) -> bool {
        self.passes
    }

    /// Names the failing figures in an error.
    pub(super) fn require(&self) -> Result<()> {
        let failed = self.rows.iter().filter(|row| !row.passes);
        let named = failed.filter_map(|row| {
            let (figure, bound) = (&row.figure, row.bound?);
            let (student, teacher) = (row.student, row.teacher);
            Some(format!(
                "{figure} is {student:.3}, expected {bound} {teacher:.3}"
            ))
        });
        let named: Vec<String> = named.collect();
        if !named.is_empty() {
            bail!("the student falls behind its teacher: {}", named.join("; "));
        }
        Ok(())
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (few, many) = (self.student_steps, self.teacher_steps);
        writeln!(f, "{} windows", self.windows)?;
        write!(
            f,
            "{:<10} {:>15} {:>15} {:>7} {:>15}",
            "figure",
            format!("student ({few})"),
            format!("teacher ({many})"),
            "ratio",
            format!("teacher ({few})")
        )?;
        for row in &self.rows {
            write!(
                f,
                "\n{:<10} {:>15.3} {:>15.3} {:>7.3} {:>15.3}",
                row.figure, row.student, row.teacher, row.ratio, row.hurried_teacher
            )?;
            if let Some(bound) = row.bound {
                write!(f, "  {bound}")?;
            }
            if !row.passes {
                write!(f, ": fails")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures(steps: usize, ratio: f64, cem: f64, idm: f64, motion: f64) -> Figures {
        Figures {
            steps,
            ratios: vec![0.1, ratio],
            motion,
            cem: Some(cem),
            idm: Some(idm),
        }
    }

    #[test]
    fn failing_figures_are_named() {
        let gate = GateRecipe {
            plans: 1,
            ratio: 1.1,
            cem: 1.1,
            idm: 0.05,
            motion: 0.8,
        };
        let teacher = figures(10, 0.5, 0.4, 0.9, 1.0);
        let verdict =
            |student: Figures| Verdict::new(4, &[student, teacher.clone(), teacher.clone()], &gate);
        let good = verdict(figures(2, 0.54, 0.43, 0.86, 0.81));
        assert!(good.passes(), "{good}");
        good.require().unwrap();
        for (student, name) in [
            (figures(2, 0.56, 0.4, 0.9, 1.0), "ratio_k2 is 0.560"),
            (figures(2, 0.5, 0.45, 0.9, 1.0), "cem is 0.450"),
            (figures(2, 0.5, 0.4, 0.84, 1.0), "idm_r is 0.840"),
            (figures(2, 0.5, 0.4, 0.9, 0.7), "motion is 0.700"),
            (figures(2, f64::NAN, 0.4, 0.9, 1.0), "ratio_k2 is NaN"),
        ] {
            let bad = verdict(student);
            let error = bad.require().unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
            assert_eq!(error.matches(" is ").count(), 1, "{error}");
            assert!(bad.to_string().contains("fails") && !bad.passes());
        }
    }
}
