use proptest::prelude::*;

use super::*;

const STEP_NS: i64 = 400_000_000;
const HORIZON: u32 = 8;

fn awaited(rollout: i64, step: u32) -> Awaited {
    let observed_ns = rollout * STEP_NS;
    Awaited {
        stamp_ns: observed_ns + i64::from(step) * STEP_NS,
        observed_ns,
        step,
        period_ns: STEP_NS,
        arrived_ns: observed_ns + 40_000_000,
    }
}

/// Whether a picture was paired with this prediction.
fn is_of(pairing: Pairing, rollout: i64, step: u32) -> bool {
    pairing == Pairing::Found(awaited(rollout, step))
}

#[test]
fn late_pictures_of_a_rollout_are_paired_in_order() {
    let mut pairings = Pairings::default();
    for rollout in 0..6 {
        (1..=HORIZON).for_each(|step| pairings.predicted(awaited(rollout, step)));
    }
    // its first picture came in time, the others when newer rollouts had their times too
    let late = |step: u32| STEP_NS / 2 + i64::from(step) * STEP_NS / 2;
    for step in 1..=HORIZON {
        let stamp = awaited(0, step).stamp_ns;
        assert!(is_of(pairings.pictured(stamp, late(step)), 0, step));
    }
    // the next decoded rollout begins late, with the same step
    let next = awaited(4, 1);
    assert!(is_of(
        pairings.pictured(next.stamp_ns, next.arrived_ns + 2 * STEP_NS),
        4,
        1
    ));
}

#[test]
fn late_picture_after_a_gap_begins_the_next_rollout() {
    let mut pairings = Pairings::default();
    (1..=HORIZON).for_each(|step| pairings.predicted(awaited(0, step)));
    let first = awaited(0, 3);
    let pairing = pairings.pictured(first.stamp_ns, first.arrived_ns);
    assert!(is_of(pairing, 0, 3), "{pairing:?}");
    for rollout in 1..6 {
        (1..=HORIZON).for_each(|step| pairings.predicted(awaited(rollout, step)));
    }
    let pairing = pairings.pictured(awaited(0, 5).stamp_ns, 9 * STEP_NS);
    assert!(is_of(pairing, 2, 3), "{pairing:?}");
}

#[test]
fn late_picture_of_several_rollouts_is_not_paired() {
    let mut pairings = Pairings::default();
    pairings.predicted(awaited(0, 2));
    pairings.predicted(awaited(1, 1));
    let pairing = pairings.pictured(awaited(1, 1).stamp_ns, 9 * STEP_NS);
    assert_eq!(pairing, Pairing::Late);
}

#[test]
fn second_copy_of_a_picture_is_of_no_prediction() {
    let mut pairings = Pairings::default();
    (1..=2).for_each(|step| pairings.predicted(awaited(0, step)));
    pairings.predicted(awaited(1, 1));
    let newest = awaited(1, 1);
    for (copy, is_paired) in [true, false].into_iter().enumerate() {
        let pairing = pairings.pictured(newest.stamp_ns, newest.arrived_ns + copy as i64);
        assert_eq!(is_of(pairing, 1, 1), is_paired, "{pairing:?}");
    }
}

proptest! {
    /// A decoder of any speed, which leaves rollouts out to keep up: each picture gets its prediction.
    #[test]
    fn whole_rollouts_are_paired_at_any_speed(
        picture_ms in 1_i64..400,
        delays in proptest::collection::vec(0_i64..900, 1..12),
    ) {
        let mut pairings = Pairings::default();
        let (mut known, mut free) = (0, 0);
        let mut know = |pairings: &mut Pairings, now: i64| {
            while awaited(known, 1).arrived_ns <= now {
                (1..=HORIZON).for_each(|step| pairings.predicted(awaited(known, step)));
                known += 1;
            }
        };
        for delay in delays {
            // the newest rollout when the decoder is free
            let rollout = (free - 40_000_000_i64).max(0) / STEP_NS + i64::from(free > 40_000_000);
            free = free.max(awaited(rollout, 1).arrived_ns) + delay * 1_000_000;
            for step in 1..=HORIZON {
                free += picture_ms * 1_000_000;
                know(&mut pairings, free);
                let pairing = pairings.pictured(awaited(rollout, step).stamp_ns, free);
                prop_assert!(is_of(pairing, rollout, step), "k={step} of {rollout}: {pairing:?}");
            }
        }
    }
}
