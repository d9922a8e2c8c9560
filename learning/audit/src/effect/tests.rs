#![allow(clippy::unwrap_used)]

use super::*;
use crate::Level;
use wm_motion::actions::{ActionSpace, Kind};

/// An arm that moves by `factors` times its actions in x, y and z.
fn episodes(factors: [f32; 3]) -> Vec<Episode> {
    let of = |seed: usize| {
        let mut made = Episode::new("e", 7);
        let mut at = [0.3, 0.0, 0.2];
        for frame in 0..60 {
            let t = (frame + seed * 13) as f32;
            let deltas = [
                (0.31 * t).sin() * 0.02,
                (0.23 * t + 1.0).cos() * 0.02,
                (0.41 * t).sin() * 0.02,
            ];
            made.push(
                &[deltas[0], deltas[1], deltas[2], 0.0, 0.0, 0.0, 1.0],
                None,
                Some(&at),
            );
            for ((at, delta), factor) in at.iter_mut().zip(deltas).zip(factors) {
                *at += factor * delta;
            }
        }
        made
    };
    (0..3).map(of).collect()
}

fn found(episodes: &[Episode]) -> Vec<Finding> {
    check(Episodes {
        episodes,
        space: &ActionSpace::bridge(),
        period_s: 0.2,
    })
}

#[test]
fn state_that_follows_the_actions_has_no_fault() {
    for gain in [1.0, 0.8] {
        let fine = found(&episodes([gain; 3]));
        assert_eq!((fine.len(), fine[0].level), (1, Level::Ok), "{fine:?}");
        assert!((fine[0].figures["dz_factor"] - f64::from(gain)).abs() < 0.02);
    }
}

#[test]
fn velocities_are_integrated_over_their_duration() {
    let velocity = |name: &str| Dimension {
        name: name.into(),
        unit: "m/s".into(),
        kind: Kind::Velocity,
        offset: 0.0,
        scale: 1.0,
        clip: 1.0,
    };
    let period_s = 0.2;
    let space = ActionSpace::new(
        "v".into(),
        1.0 / period_s,
        ["vx", "vy", "vz"].map(velocity).into(),
    );
    let space = space.unwrap();
    // The state moves by `factor` times the value; the correct factor is a fifth.
    for (factor, level) in [(0.2, Level::Ok), (1.0, Level::Warning)] {
        let episodes = episodes([factor; 3]);
        let found = check(Episodes {
            episodes: &episodes,
            space: &space,
            period_s,
        });
        assert_eq!(found[0].level, level, "{found:?}");
        let expected = f64::from(factor) / period_s;
        assert!(
            (found[0].figures["vx_factor"] - expected).abs() < 0.1,
            "{found:?}"
        );
    }
}

#[test]
fn factor_of_two_is_found_in_both_directions() {
    for factor in [2.0, 0.5] {
        let twice = found(&episodes([1.0, 1.0, factor]));
        assert_eq!(
            (twice.len(), twice[0].level),
            (1, Level::Warning),
            "{twice:?}"
        );
        assert!((twice[0].figures["dz_factor"] - f64::from(factor)).abs() < 0.05);
        assert!(
            twice[0].what.starts_with("dz: the state changes by"),
            "{twice:?}"
        );
    }
}

#[test]
fn flipped_sign_is_found() {
    let flipped = found(&episodes([1.0, -1.0, 1.0]));
    assert_eq!(
        (flipped.len(), flipped[0].level),
        (1, Level::Warning),
        "{flipped:?}"
    );
    assert!(
        flipped[0].what.starts_with("dy: the state moves against"),
        "{flipped:?}"
    );
}

#[test]
fn swapped_axes_are_unrelated() {
    let mut swapped = episodes([1.0; 3]);
    for episode in &mut swapped {
        let width = 7;
        let mut made = Episode::new("e", width);
        for frame in 0..episode.len() {
            let action = |d: usize| episode.actions(d)[frame];
            let state: Vec<f32> = (0..3).map(|d| episode.state(d)[frame]).collect();
            made.push(
                &[action(1), action(2), action(0), 0.0, 0.0, 0.0, 1.0],
                None,
                Some(&state),
            );
        }
        *episode = made;
    }
    let names: Vec<String> = found(&swapped).iter().map(|f| f.what.clone()).collect();
    assert!(
        names.iter().any(|what| what.contains("do not explain")),
        "{names:?}"
    );
}

#[test]
fn missing_state_is_not_judged() {
    let mut unknown = episodes([1.0; 3]);
    for episode in &mut unknown {
        let mut made = Episode::new("e", 7);
        for frame in 0..episode.len() {
            made.push(&[episode.actions(0)[frame]], None, None);
        }
        *episode = made;
    }
    let none = found(&unknown);
    assert!(
        none[0].level == Level::Ok && none[0].what.contains("no state"),
        "{none:?}"
    );
}
