//! Checks of actions alone: idle time, zeros at the end, outliers, units, gripper ranges.

use crate::{
    Finding,
    episode::{Effect, Episode, Episodes},
    quantile::quantile,
};
use wm_motion::actions::{ActionSurvey, Cause, Contradiction, Dimension, Hint, Kind};

/// Share of idle frames that is a fault. Four real data sets have 0 to 0.12.
const IDLE: f64 = 0.5;
/// Share of frames idle at the start, or at the end, of episodes that is a fault.
const IDLE_END: f64 = 0.2;
/// Idle start or end that gets a note \[s\].
const LONG_S: f64 = 1.0;
/// Shortest episode whose last action is checked \[frames\].
const EPISODE_MIN: usize = 5;
/// Minimum number of actions for the search for outliers.
const ACTIONS_MIN: usize = 50;
/// Quantile of the magnitudes of a dimension up to which values are usual.
const USUAL: f64 = 0.95;
/// An outlier exceeds the usual changes by this factor. None of 17,000 real actions does.
const OUTLIER: f32 = 10.0;
/// As [`OUTLIER`], for targets, which may jump: those of a real hand do by a factor of 14.
const OUTLIER_OF_TARGETS: f32 = 25.0;
/// The usual change of a dimension is at least this share of the largest of its kind.
const OF_KIND: f32 = 1.0 / 3.0;
/// Speed limit of a plausible end effector \[m/s\].
const SPEED_LIMIT: f64 = 2.0;
/// Share of actions that may exceed [`SPEED_LIMIT`].
const FAST_SHARE: f64 = 0.1;
/// Name of the check of the gripper's range.
const GRIPPER: &str = "gripper";

pub(crate) fn check(all: Episodes<'_>) -> Vec<Finding> {
    let mut findings = vec![check_idle(all)];
    findings.extend(check_last_action(all));
    findings.extend(find_outliers(all));
    findings.extend(check_units(all));
    findings.extend(check_grippers(all));
    findings
}

fn check_idle(all: Episodes<'_>) -> Finding {
    let idle = all.idle();
    let frames = all.frames().max(1) as f64;
    let count = idle.iter().flatten().filter(|idle| **idle).count() as f64;
    let starts = idle
        .iter()
        .map(|episode| episode.iter().take_while(|idle| **idle).count());
    let ends = idle.iter().map(|episode| {
        // A wholly idle episode counts as a start without an end.
        let is_moving = episode.iter().any(|idle| !idle);
        let end = episode.iter().rev().take_while(|idle| **idle).count();
        if is_moving { end } else { 0 }
    });
    let (starts, ends): (Vec<usize>, Vec<usize>) = (starts.collect(), ends.collect());
    let share = count / frames;
    let sum_share = |frames_idle: &[usize]| frames_idle.iter().sum::<usize>() as f64 / frames;
    let median_s = |frames_idle: &[usize]| {
        let values = frames_idle.iter().map(|count| *count as f32);
        // 0 without episodes.
        f64::from(quantile(values, 0.5).unwrap_or(0.0)) * all.period_s
    };
    let (start_s, end_s) = (median_s(&starts), median_s(&ends));
    let (start_share, end_share) = (sum_share(&starts), sum_share(&ends));
    let what = format!(
        "the robot is idle in {:.0} % of the frames; the median episode begins with {start_s:.1} s and ends with {end_s:.1} s \
         of it",
        share * 100.0
    );
    let is_long = |seconds: f64, share: f64| seconds >= LONG_S && share >= IDLE_END;
    let is_fault = share >= IDLE || is_long(start_s, start_share) || is_long(end_s, end_share);
    let finding = if is_fault {
        Finding::warning("idle", what)
            .because("a model learns standstill instead of motion")
            .fix("remove idle parts: wm bag cut, or --cut-topic with a topic that has a message when the task begins")
    } else if start_s >= LONG_S || end_s >= LONG_S {
        Finding::note("idle", what)
    } else {
        Finding::ok("idle", what)
    };
    finding
        .figure("idle_share", share)
        .figure("idle_start_s", start_s)
        .figure("idle_end_s", end_s)
        .figure("idle_start_share", start_share)
        .figure("idle_end_share", end_share)
}

/// Reports actions that change the state and are zero only in the last frame.
fn check_last_action(all: Episodes<'_>) -> Option<Finding> {
    let changes = all.changes();
    let is_change = |dimension: &&Dimension| Effect::of(dimension.kind) == Effect::Change;
    all.space.dimensions().iter().find(is_change)?;
    let judged = changes.iter().filter(|episode| {
        let frames = episode.first().map_or(0, Vec::len);
        frames >= EPISODE_MIN && episode.iter().flatten().any(|value| *value != 0.0)
    });
    let judged: Vec<_> = judged.collect();
    let is_zero = |episode: &&&Vec<Vec<f32>>| {
        episode
            .iter()
            .all(|values| values.last().is_none_or(|value| *value == 0.0))
    };
    let zero = judged.iter().filter(is_zero).count();
    (zero > 0 && zero * 2 >= judged.len()).then(|| {
        let what = format!(
            "the last action is zero in {zero} of {} episodes",
            judged.len()
        );
        Finding::note("last", what)
            .because("the last frame has no successor, so no model is trained on this action")
            .fix("nothing")
            .figure("last_action_zero", zero as f64)
    })
}

fn find_outliers(all: Episodes<'_>) -> Vec<Finding> {
    if all.frames() < ACTIONS_MIN {
        return Vec::new();
    }
    let changes = all.changes();
    let dimensions = all.space.dimensions();
    let column = |index: usize| {
        let episodes = changes.iter().filter_map(move |episode| episode.get(index));
        episodes.flatten().map(|value| value.abs())
    };
    let usual: Vec<f32> = (0..dimensions.len())
        // 0 without values, which disables the check.
        .map(|index| quantile(column(index), USUAL).unwrap_or(0.0))
        .collect();
    let findings = dimensions.iter().enumerate().filter_map(|(index, dimension)| {
        let like = dimensions.iter().zip(&usual);
        let like = like.filter(|(other, _)| (other.kind, &other.unit) == (dimension.kind, &dimension.unit));
        let of_kind = like.map(|(_, usual)| *usual).fold(0.0, f32::max) * OF_KIND;
        // In range: `usual` has one value per dimension.
        let own = usual.get(index).copied().unwrap_or(0.0);
        let times = match Effect::of(dimension.kind) {
            Effect::Target => OUTLIER_OF_TARGETS,
            _ => OUTLIER,
        };
        let limit = own.max(of_kind) * times;
        let beyond = column(index).filter(|value| limit > 0.0 && *value > limit).count();
        (beyond > 0).then(|| {
            let most = column(index).fold(0.0, f32::max);
            let unit = &dimension.unit;
            let name = &dimension.name;
            let what = format!(
                "{name}: {beyond} actions are far beyond the others: up to {most:.3} {unit}, while 95 % are below \
                 {own:.3} {unit}"
            );
            Finding::warning("outliers", what)
                .because("a few wrong values widen the scale that all actions are trained with")
                .fix("inspect these moments (wm view BAG), and remove them (wm bag cut)")
                .figure("outliers", beyond as f64)
                .figure("greatest", f64::from(most))
        })
    });
    findings.collect()
}

/// Reports implausible changes of position: absolute positions, or another unit.
fn check_units(all: Episodes<'_>) -> Option<Finding> {
    let dimensions = all.space.dimensions();
    let is_metre = |d: &Dimension| {
        let unit = (d.kind, d.unit.as_str());
        matches!(
            unit,
            (Kind::TranslationDelta, "m") | (Kind::Velocity, "m/s")
        )
    };
    let axes = (0..dimensions.len()).filter(|index| dimensions.get(*index).is_some_and(is_metre));
    let axes: Vec<usize> = axes.collect();
    let speeds = |episode: &Episode| -> Vec<f64> {
        let columns = axes.iter().filter_map(|axis| {
            let of_one = all.change_of_one(dimensions.get(*axis)?.kind);
            Some((episode.actions(*axis), of_one))
        });
        let columns: Vec<(Vec<f32>, f64)> = columns.collect();
        let squares = (0..episode.len()).map(|frame| {
            let values = columns
                .iter()
                .filter_map(|(column, of_one)| Some(f64::from(*column.get(frame)?) * of_one));
            values.map(|value| value.powi(2)).sum::<f64>()
        });
        squares.map(|square| square.sqrt() / all.period_s).collect()
    };
    let speeds: Vec<f64> = all.episodes.iter().flat_map(speeds).collect();
    let fast = speeds.iter().filter(|speed| **speed > SPEED_LIMIT).count();
    let share = fast as f64 / speeds.len().max(1) as f64;
    (share > FAST_SHARE).then(|| {
        let most = speeds.iter().copied().fold(0.0, f64::max);
        let what = format!(
            "{:.0} % of the actions move the end effector by more than {SPEED_LIMIT} m/s, up to {most:.1} m/s",
            share * 100.0
        );
        Finding::warning("units", what)
            .because("no arm is so fast: the values may be positions instead of changes, or in another unit")
            .fix("set an --action-space with the kinds and units of the recording")
            .figure("fast_share", share)
            .figure("fastest_m_s", most)
    })
}

/// Reports grippers outside 0 (closed) to 1 (open), or inverted ones.
fn check_grippers(all: Episodes<'_>) -> Vec<Finding> {
    let mut survey = ActionSurvey::new(all.space.clone(), all.space.rate());
    for episode in all.episodes {
        survey.add(&episode.rows(), &[] as &[&[f32]]);
    }
    let contradictions = survey.contradictions();
    let ranges = contradictions.iter().filter_map(|found| match found.cause {
        Cause::Gripper { closed, open } => Some(gripper_range(found, (closed, open))),
        _ => None,
    });
    let hints = survey.hints();
    let inverted = hints.iter().filter(|hint| hint.is_inverted());
    let inverted = inverted.map(|hint: &Hint| {
        Finding::note(GRIPPER, hint.to_string())
            .because("for a model and for commands of the executor, 1 is open")
            .fix("compare it with the pictures; if so, set an --action-space with an inverted gripper")
    });
    ranges.chain(inverted).collect()
}

/// The finding for a gripper with values from `closed` to `open`.
fn gripper_range(found: &Contradiction, (closed, open): (f32, f32)) -> Finding {
    let name = &found.column;
    let scale = |closed: f32, open: f32| (open - closed).recip();
    Finding::warning(GRIPPER, found.to_string())
        .because("for a model and for commands of the executor, 0 is closed and 1 is open")
        .fix(format!(
            "set an --action-space whose {name} is gripper_continuous with offset {closed} and scale {}, or with offset \
             {open} and scale {} if {open} is closed",
            scale(closed, open),
            scale(open, closed)
        ))
        .figure("least", f64::from(found.measured.low))
        .figure("greatest", f64::from(found.measured.high))
}

#[cfg(test)]
mod tests;
