#![allow(clippy::unwrap_used)]

use proptest::prelude::*;

use super::*;
use crate::actions::{Accumulation, ActionEncoding};

fn dimension(name: &str, kind: Kind, unit: &str) -> Dimension {
    Dimension {
        name: name.into(),
        unit: unit.into(),
        kind,
        offset: 0.0,
        scale: 3.0,
        clip: 1.0,
    }
}

fn fitted(dimensions: &[(Kind, &str)], spreads: &[Spread]) -> Vec<Dimension> {
    let names = ["a", "b", "c", "d"];
    let dimensions = names.iter().zip(dimensions);
    let dimensions = dimensions.map(|(name, (kind, unit))| dimension(name, *kind, unit));
    let space = ActionSpace::new("test".into(), 10.0, dimensions.collect()).unwrap();
    space.fitted(spreads).unwrap().dimensions().to_vec()
}

fn spread(least: f64, low: f64, high: f64, most: f64) -> Spread {
    Spread {
        least,
        low,
        high,
        most,
    }
}

fn near(found: f32, expected: f64) -> bool {
    (f64::from(found) - expected).abs() <= 1e-6 * expected.abs().max(1e-6)
}

/// numpy.quantile([1, 2, 3, 4, 10], [.001, .01, .99, .999])
#[test]
fn spread_has_the_quantiles_of_numpy() {
    let found = Spread::of([10.0, 3.0, 1.0, 4.0, 2.0]).unwrap();
    let expected = [1.004, 1.04, 9.76, 9.976];
    let found = [found.least, found.low, found.high, found.most];
    for (found, expected) in found.into_iter().zip(expected) {
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }
    assert_eq!(Spread::of([]), None);
}

#[test]
fn outer_quantiles_map_to_one() {
    let kinds = [
        (Kind::JointVelocity, "rad/s"),
        (Kind::JointPosition, "rad"),
        (Kind::GripperContinuous, "1"),
    ];
    let spreads = [
        spread(-0.6, -0.2, 0.5, 0.7),
        spread(0.4, 0.5, 1.5, 1.6),
        spread(0.0, 3.0, 80.0, 100.0),
    ];
    let found = fitted(&kinds, &spreads);
    assert!(near(found[0].scale, 2.0) && found[0].offset == 0.0);
    assert!(near(found[1].scale, 2.0) && near(found[1].offset, 1.0));
    assert!(near(found[2].scale, 0.01) && found[2].offset == 0.0);
    assert!(found.iter().all(|dimension| dimension.clip == 1.5));
}

#[test]
fn rare_motion_is_seen_and_its_noise_is_not_amplified() {
    let found = fitted(
        &[(Kind::JointVelocity, "rad/s")],
        &[spread(-0.5, -0.001, 0.002, 0.3)],
    );
    assert!(near(found[0].scale, 10.0), "{found:?}");
    let found = fitted(&[(Kind::Position, "1")], &[spread(1.0, 2.0, 2.0, 2.0)]);
    assert!(near(found[0].scale, 10.0) && near(found[0].offset, 2.0));
}

#[test]
fn still_joint_is_scaled_like_its_moving_neighbours() {
    let kinds = [
        (Kind::JointPosition, "rad"),
        (Kind::JointPosition, "rad"),
        (Kind::JointPosition, "1"),
        (Kind::JointPosition, "1"),
    ];
    let wide = spread(-1.0, -1.0, 1.0, 1.0);
    let noise = spread(0.2, 0.201, 0.209, 0.21);
    let found = fitted(&kinds, &[wide, noise, wide, noise]);
    assert!(near(found[1].scale, 10.0), "{found:?}");
    // Values in unknown units are not comparable.
    assert!(near(found[3].scale, 250.0), "{found:?}");
}

#[test]
fn noise_of_encoders_is_not_amplified() {
    let noise = spread(1.0, 1.0, 1.0 + 1e-7, 1.0 + 1e-7);
    for (kind, unit, scale) in [
        (Kind::JointPosition, "rad", 500.0),
        (Kind::Position, "mm", 0.5),
        (Kind::Position, "1", 1000.0),
    ] {
        let found = fitted(&[(kind, unit)], &[noise]);
        assert!((found[0].scale / scale - 1.0).abs() < 1e-3, "{found:?}");
    }
    let noise = spread(-1e-7, -1e-7, 1e-7, 1e-7);
    for (kind, unit, scale) in [
        (Kind::JointVelocity, "rad/s", 500.0),
        (Kind::JointDelta, "rad", 5000.0),
    ] {
        let found = fitted(&[(kind, unit)], &[noise]);
        assert!((found[0].scale / scale - 1.0).abs() < 1e-3, "{found:?}");
    }
}

#[test]
fn constants_and_binary_grippers_keep_their_scales() {
    let kinds = [
        (Kind::JointDelta, "rad"),
        (Kind::JointPosition, "1"),
        (Kind::GripperContinuous, "1"),
        (Kind::GripperBinary, "1"),
    ];
    let constant = |value| spread(value, value, value, value);
    let spreads = [
        constant(0.0),
        constant(7.0),
        constant(0.5),
        spread(0.0, 0.0, 1.0, 1.0),
    ];
    let found = fitted(&kinds, &spreads);
    for (found, (kind, unit)) in found.iter().zip(kinds) {
        let expected = dimension(&found.name, kind, unit);
        assert_eq!(found, &expected);
    }
}

proptest! {
    /// The bulk of the values uses the range, and values of any size fit.
    #[test]
    fn bulk_of_the_values_is_not_clipped(
        values in prop::collection::vec(-1e4_f32..1e4, 2..300), kind in 0..4_usize,
    ) {
        let kind = [Kind::JointVelocity, Kind::JointDelta, Kind::JointPosition, Kind::GripperContinuous][kind];
        let space = ActionSpace::new("a".into(), 5.0, vec![dimension("a", kind, "1")]).unwrap();
        let spread = Spread::of(values.iter().copied()).unwrap();
        let fitted = space.fitted(&[spread]).unwrap();
        let encoding = ActionEncoding::new(fitted, 1, 1, Accumulation::Mean).unwrap();
        let inside = values.iter().filter(|value| {
            (spread.low..=spread.high).contains(&f64::from(**value))
        });
        for value in inside {
            let model = encoding.encode_step(&[[*value]]).unwrap();
            prop_assert_eq!(model.clipped, 0);
            prop_assert!(model.values[0].abs() <= 1.001, "{} -> {}", value, model.values[0]);
        }
    }
}
