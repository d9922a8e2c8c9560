//! Comparison of the actions with the changes of the state.

use crate::{
    Finding,
    episode::{Effect, Episode, Episodes},
};
use wm_motion::actions::Dimension;

const CHECK: &str = "state";
/// Length of the windows over which actions and changes of the state are summed, so that noise and controller delays matter
/// little \[s\].
const WINDOW_S: f64 = 1.0;
/// Largest lead of the state over the actions \[frames\].
const LEAD: i64 = 2;
/// Largest lag of the state behind the actions \[frames\].
const FOLLOW: i64 = 10;
/// Minimum number of disjoint windows for a verdict.
const WINDOWS_MIN: f64 = 6.0;
/// Minimum number of disjoint windows for the verdict "unrelated".
const WINDOWS_MIN_UNRELATED: f64 = 20.0;
/// Correlation from which a factor is reliable.
const SURE: f64 = 0.9;
/// Correlation below which actions and state are unrelated.
const UNRELATED: f64 = 0.3;
/// Accepted ratio of the state's change to the commanded one.
const FACTORS: std::ops::RangeInclusive<f64> = 1.0 / 1.5..=1.5;
/// As [`FACTORS`], for targets, which a finger that holds an object does not reach: the ratio of a real hand was 0.2.
const FACTORS_OF_TARGETS: std::ops::RangeInclusive<f64> = 0.1..=1.5;
/// Dimensions that move less than this share of the largest motion of their kind are not judged.
const MOVES: f64 = 0.2;

/// Linear fit of a dimension's state changes to its actions.
#[derive(Clone, Copy, Debug)]
struct Fit {
    /// Change of the state per unit of action.
    factor: f64,
    correlation: f64,
    /// Root mean squares of the actions and of the state's changes.
    action: f64,
    state: f64,
    /// Number of disjoint windows.
    windows: f64,
}

/// Checks, by dimension, that the state changes as commanded.
pub(crate) fn check(all: Episodes<'_>) -> Vec<Finding> {
    // Limited to one frame up to those of an hour.
    let window = ((WINDOW_S / all.period_s).round() as usize).max(1);
    let dimensions: Vec<&Dimension> = all.space.dimensions().iter().collect();
    let fits = dimensions.iter().enumerate().map(|(index, dimension)| {
        let shifts = -LEAD..=FOLLOW;
        let fits = shifts.filter_map(|shift| fit_factor(&all, index, dimension, window, shift));
        let fits = fits.filter(|fit| fit.windows >= WINDOWS_MIN);
        fits.max_by(|a, b| a.correlation.abs().total_cmp(&b.correlation.abs()))
    });
    let fits: Vec<Option<Fit>> = fits.collect();
    if fits.iter().all(Option::is_none) {
        return vec![Finding::ok(
            CHECK,
            "not judged: no state for these actions is recorded",
        )];
    }
    let mut findings = Vec::new();
    let mut agreed = Vec::new();
    let mut ok = Finding::ok(CHECK, "");
    for (dimension, fit) in dimensions.iter().zip(&fits) {
        let Some(fit) = fit else { continue };
        let like = dimensions.iter().zip(&fits);
        let like = like
            .filter(|(other, _)| (other.kind, &other.unit) == (dimension.kind, &dimension.unit));
        let like: Vec<&Fit> = like.filter_map(|(_, fit)| fit.as_ref()).collect();
        let most = |of: fn(&Fit) -> f64| like.iter().map(|fit| of(fit)).fold(0.0, f64::max);
        let acts = fit.action > MOVES * most(|fit| fit.action) && fit.action > 0.0;
        let moves = fit.state > MOVES * most(|fit| fit.state);
        let factor = format!("{}_factor", dimension.name);
        let correlation = format!("{}_correlation", dimension.name);
        let figures = |finding: Finding| {
            finding
                .figure(&factor, fit.factor)
                .figure(&correlation, fit.correlation)
        };
        match judge(dimension, fit, acts, moves) {
            Some(finding) => findings.push(figures(finding)),
            None => {
                if acts && fit.correlation >= SURE {
                    agreed.push(format!("{} {:.2}", dimension.name, fit.factor));
                }
                ok = figures(ok);
            }
        }
    }
    if findings.is_empty() {
        ok.what = if agreed.is_empty() {
            "not judged: too little motion, or too short".to_owned()
        } else {
            format!(
                "the state changes as the actions say, by a factor of: {}",
                agreed.join(", ")
            )
        };
        findings.push(ok);
    }
    findings
}

/// Judges a dimension. `acts`, `moves`: whether its actions and its state move enough.
fn judge(dimension: &Dimension, fit: &Fit, acts: bool, moves: bool) -> Option<Finding> {
    let name = &dimension.name;
    let why = "a model trained on it expects other motions than commands cause, and plans fail";
    let measured = format!("correlation {:.2}", fit.correlation);
    let factors = match Effect::of(dimension.kind) {
        Effect::Target => FACTORS_OF_TARGETS,
        _ => FACTORS,
    };
    if acts && fit.correlation <= -SURE {
        let what = format!(
            "{name}: the state moves against the actions (factor {:.2}, {measured})",
            fit.factor
        );
        return Some(
            Finding::warning(CHECK, what)
                .because(why)
                .fix("the sign or the frame of this value differs: see \"Frames and units\" in docs/your-robot.md"),
        );
    }
    if acts && fit.correlation >= SURE && !factors.contains(&fit.factor) {
        let what = format!(
            "{name}: the state changes by {:.2} times what the actions say ({measured})",
            fit.factor
        );
        return Some(
            Finding::warning(CHECK, what)
                .because(why)
                .fix(format!("check the unit and the scale of {name}, and how long an action lasts (rate of the actions)")),
        );
    }
    let is_unrelated = acts && moves && fit.correlation.abs() < UNRELATED;
    if is_unrelated && fit.windows >= WINDOWS_MIN_UNRELATED {
        let what = format!("{name}: the actions do not explain how the state changes ({measured})");
        return Some(Finding::warning(CHECK, what).because(why).fix(
            "check the order and the frame of the values, and that actions and state are of one arm",
        ));
    }
    None
}

/// Fits the windows of a dimension, with the state shifted by `shift` frames.
fn fit_factor(
    all: &Episodes<'_>,
    index: usize,
    dimension: &Dimension,
    window: usize,
    shift: i64,
) -> Option<Fit> {
    let effect = Effect::of(dimension.kind);
    if effect == Effect::Gripper {
        return None;
    }
    let of_one = all.change_of_one(dimension.kind);
    let (mut xy, mut xx, mut yy, mut count) = (0.0, 0.0, 0.0, 0.0);
    for episode in all.episodes {
        for (x, y) in sum_windows(episode, index, effect, window, shift) {
            let x = x * of_one;
            xy += x * y;
            xx += x * x;
            yy += y * y;
            count += 1.0;
        }
    }
    if count < 1.0 {
        return None;
    }
    let magnitude = (xx * yy).sqrt();
    Some(Fit {
        factor: if xx > 0.0 { xy / xx } else { 0.0 },
        correlation: if magnitude > 0.0 { xy / magnitude } else { 0.0 },
        action: (xx / count).sqrt(),
        state: (yy / count).sqrt(),
        windows: count / window as f64,
    })
}

/// By window: the sum of the actions, and the change of the state.
fn sum_windows(
    episode: &Episode,
    index: usize,
    effect: Effect,
    window: usize,
    shift: i64,
) -> Vec<(f64, f64)> {
    let actions = episode.actions(index);
    // Cumulative sums at each frame, or the targets.
    let paths: Vec<f64> = match effect {
        Effect::Change => {
            let mut sum = 0.0;
            let sums = actions.iter().map(|action| {
                let before = sum;
                sum += f64::from(*action);
                before
            });
            sums.collect()
        }
        _ => actions.iter().map(|action| f64::from(*action)).collect(),
    };
    let state: Vec<f64> = episode
        .state(index)
        .iter()
        .map(|value| f64::from(*value))
        .collect();
    let shifted = |at: usize| {
        let at = i64::try_from(at).ok()?.checked_add(shift)?;
        state.get(usize::try_from(at).ok()?).copied()
    };
    let begins = 0..paths.len().saturating_sub(window);
    let pairs = begins.filter_map(|at| {
        let x = paths.get(at + window)? - paths.get(at)?;
        let y = shifted(at + window)? - shifted(at)?;
        (x.is_finite() && y.is_finite()).then_some((x, y))
    });
    pairs.collect()
}

#[cfg(test)]
mod tests;
