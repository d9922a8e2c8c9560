//! Checks that pictures, actions and state have the same time.

use crate::{
    Finding,
    correlation::{LAG_LIMIT, Lag},
    episode::{Effect, Episode, Episodes, differences, speeds},
    quantile::quantile,
};

const CHECK: &str = "lag";
/// Minimum number of frames for a verdict.
const FRAMES_MIN: usize = 30;
/// Minimum correlation of motion with actions that change the state.
const CORRELATION_MIN: f64 = 0.3;
/// Minimum correlation of motion with targets, which lead it by a varying time.
const CORRELATION_MIN_TARGETS: f64 = 0.2;
/// Shift that is a fault \[frames\]. Real arms begin to move up to a frame after their command (Bridge V2: one frame of
/// 0.2 s).
const FAULT: i64 = 2;
/// Accepted lag of an arm behind its targets \[s\].
const FOLLOW_LIMIT_S: f64 = 0.5;
/// Correlation below which actions and motion are unrelated at every shift. Five real robots have 0.26 to 0.81; with actions
/// of other moments, below 0.05.
const UNRELATED: f64 = 0.12;
/// Minimum number of frames for the verdict "unrelated".
const UNRELATED_FRAMES: usize = 500;
/// Quantile of the picture's change that counts as noise.
const NOISE: f64 = 0.05;

/// Checks the lag of the pictures behind the actions and the state.
pub(crate) fn check(all: Episodes<'_>) -> Vec<Finding> {
    if all.frames() < FRAMES_MIN {
        let what = format!(
            "not judged: {} frames; {FRAMES_MIN} are needed",
            all.frames()
        );
        return vec![Finding::ok(CHECK, what)];
    }
    let shown = picture_motion(all.episodes);
    let acts = speeds(&all.changes());
    let of_actions = Lag::of(&pairs(&acts, &shown));
    let moves = speeds(&state_changes(&all));
    let of_state = Lag::of(&pairs(&moves, &shown));
    let is_target = |kind| Effect::of(kind) == Effect::Target;
    let mut kinds = all.space.dimensions().iter().map(|d| d.kind);
    let has_targets = kinds.any(is_target);
    let least = if has_targets {
        CORRELATION_MIN_TARGETS
    } else {
        CORRELATION_MIN
    };
    let Some(lag) = of_actions else {
        return vec![constant_series(&all, &shown)];
    };
    if lag.correlation < UNRELATED && lag.count >= UNRELATED_FRAMES {
        return vec![unrelated_actions(&lag)];
    }
    let finding = if lag.correlation < least || lag.count < FRAMES_MIN {
        Finding::ok(
            CHECK,
            format!("not judged: correlation {:.2} at best", lag.correlation),
        )
    } else {
        judge(
            &lag,
            of_state.filter(Lag::is_significant),
            has_targets,
            all.period_s,
        )
    };
    vec![add_figures(finding, &lag, of_state.as_ref(), all.period_s)]
}

/// Judges a sufficient correlation.
fn judge(lag: &Lag, of_state: Option<Lag>, has_targets: bool, period_s: f64) -> Finding {
    let seconds = |frames: i64| frames.unsigned_abs() as f64 * period_s;
    let frames = |frames: i64| match frames.unsigned_abs() {
        1 => "1 frame".to_owned(),
        count => format!("{count} frames"),
    };
    let measured = format!(
        "correlation {:.2} against {:.2} without a shift, confidence {:.1} %",
        lag.correlation,
        lag.unshifted,
        // Never 100 %: the distribution has no end.
        (lag.confidence() * 100.0).min(99.9)
    );
    let fix = |shift: i64| {
        format!(
            "wm dataset --shift-actions {shift} (moves each action {} {}), or stamp frames and actions when they happen",
            frames(shift),
            if shift > 0 { "later" } else { "earlier" }
        )
    };
    let why = "a model learns the effect of actions of another moment";
    let camera =
        of_state.filter(|lag| lag.correlation >= CORRELATION_MIN && lag.frames.abs() >= FAULT);
    if let Some(camera) = camera {
        let what = format!(
            "the pictures {} the state by {} ({:.2} s): correlation {:.2} against {:.2} without a shift",
            if camera.frames > 0 { "lag" } else { "lead" },
            frames(camera.frames),
            seconds(camera.frames),
            camera.correlation,
            camera.unshifted
        );
        let shift = if lag.is_significant() {
            lag.frames
        } else {
            camera.frames
        };
        return Finding::warning(CHECK, what).because(why).fix(fix(shift));
    }
    if !lag.is_significant() && lag.frames != 0 {
        let what = format!(
            "no shift is surely better than none: correlation {:.2} without, {:.2} at {}",
            lag.unshifted,
            lag.correlation,
            frames(lag.frames)
        );
        return Finding::ok(CHECK, what);
    }
    if lag.frames == 0 {
        let what = format!(
            "pictures and actions are of the same moment: correlation {:.2} without a shift",
            lag.unshifted
        );
        return Finding::ok(CHECK, what);
    }
    let follows = format!(
        "the pictures {} the actions by {} ({:.2} s): {measured}",
        if lag.frames > 0 { "lag" } else { "lead" },
        frames(lag.frames),
        seconds(lag.frames)
    );
    if has_targets && lag.frames > 0 && seconds(lag.frames) <= FOLLOW_LIMIT_S {
        return Finding::note(CHECK, follows)
            .because("an arm follows its targets with such a delay")
            .fix(format!(
                "nothing; to have actions at the moment of their effect: {}",
                fix(lag.frames)
            ));
    }
    if lag.frames.abs() < FAULT {
        return Finding::note(CHECK, follows)
            .because("an arm that follows commands begins to move that late")
            .fix(format!(
                "nothing; to have actions at the moment of their effect: {}",
                fix(lag.frames)
            ));
    }
    Finding::warning(CHECK, follows)
        .because(why)
        .fix(fix(lag.frames))
}

fn add_figures(finding: Finding, lag: &Lag, of_state: Option<&Lag>, period_s: f64) -> Finding {
    let finding = finding
        .figure("lag_frames", lag.frames as f64)
        .figure("lag_s", lag.frames as f64 * period_s)
        .figure("correlation", lag.correlation)
        .figure("correlation_unshifted", lag.unshifted)
        .figure("second_lag_frames", lag.second as f64)
        .figure("second_correlation", lag.second_correlation)
        .figure("standard_errors", lag.score)
        .figure("confidence", lag.confidence())
        .figure("frames", lag.count as f64);
    match of_state {
        Some(state) => finding
            .figure("state_lag_frames", state.frames as f64)
            .figure("state_correlation", state.correlation),
        None => finding,
    }
}

fn unrelated_actions(lag: &Lag) -> Finding {
    let what = format!(
        "the actions explain no motion in the pictures: correlation {:.2} at best, over {} frames and shifts of up to \
         {LAG_LIMIT} frames",
        lag.correlation, lag.count
    );
    let finding = Finding::warning(CHECK, what)
        .because("a model learns to ignore such actions")
        .fix("check that camera and actions are of the same robot and the same clock, and what the values mean (--action-space)");
    add_figures(finding, lag, None, 0.0)
}

/// The finding for constant actions or pictures.
fn constant_series(all: &Episodes<'_>, shown: &[Vec<f32>]) -> Finding {
    let acts = all.changes();
    let is_still = acts.iter().flatten().flatten().all(|value| *value == 0.0);
    let moves = shown.iter().flatten().any(|moves| *moves > 1.0);
    if is_still && moves {
        let what = format!(
            "the actions are zero in all {} frames, while the pictures change",
            all.frames()
        );
        return Finding::warning(CHECK, what)
            .because("a model learns to ignore such actions")
            .fix("check --action-topic, and what the arm's driver publishes there");
    }
    let known = shown.iter().flatten().any(|moves| moves.is_finite());
    let what = match (is_still, known) {
        (true, _) => "not judged: the actions are zero",
        (_, false) => "not judged: no pictures were compared",
        _ => "not judged: pictures or actions never vary",
    };
    Finding::ok(CHECK, what)
}

/// Motion in the pictures between frames, without noise. The root limits the weight of a passing hand or a change of light.
fn picture_motion(episodes: &[Episode]) -> Vec<Vec<f32>> {
    let all = episodes.iter().flat_map(Episode::motion);
    // Without known changes there is nothing to subtract it from.
    let noise = quantile(all, NOISE).unwrap_or(0.0);
    let of_episode = |episode: &Episode| {
        let without_noise = |moves: f32| match moves.is_finite() {
            true => (moves - noise).max(0.0).sqrt(),
            false => f32::NAN,
        };
        episode.motion().map(without_noise).collect()
    };
    episodes.iter().map(of_episode).collect()
}

/// Changes of the state between frames, by episode and dimension, if known.
fn state_changes(all: &Episodes<'_>) -> Vec<Vec<Vec<f32>>> {
    let of_episode = |episode: &Episode| {
        let dimensions = (0..).zip(all.space.dimensions());
        let moved = dimensions.filter(|(_, d)| !d.kind.is_gripper());
        let moved = moved.map(|(index, _)| {
            let changes = differences(&episode.state(index));
            // To the next frame.
            changes.into_iter().skip(1).collect()
        });
        moved.collect()
    };
    all.episodes.iter().map(of_episode).collect()
}

fn pairs(speeds: &[Vec<f32>], shown: &[Vec<f32>]) -> Vec<(Vec<f32>, Vec<f32>)> {
    let roots = |values: &Vec<f32>| values.iter().map(|value| value.sqrt()).collect();
    let pairs = speeds.iter().zip(shown);
    pairs
        .map(|(speeds, shown)| (roots(speeds), shown.clone()))
        .collect()
}

#[cfg(test)]
mod tests;
