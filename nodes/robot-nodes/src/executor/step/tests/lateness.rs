//! Late chunks.

use proptest::prelude::*;

use super::*;

/// The motion of an arm with late chunks.
#[derive(Debug, Default)]
struct Motion {
    /// Forward velocity of each command, 50 ms apart \[m/s\].
    forward: Vec<f64>,
    notices: usize,
}

impl Motion {
    /// Ticks at which the arm set out from rest.
    fn starts(&self) -> Vec<usize> {
        let pairs = self.forward.iter().zip(self.forward.iter().skip(1));
        let is_start = |(index, (before, next)): (usize, (&f64, &f64))| {
            (*before == 0.0 && *next > 0.0).then_some(index)
        };
        pairs.enumerate().filter_map(is_start).collect()
    }

    /// The greatest change from one command to the next \[m/s\].
    fn jolt(&self) -> f64 {
        let pairs = self.forward.iter().zip(self.forward.iter().skip(1));
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }
}

/// Executes chunks of `span_ms` at 0.1 m/s: one every `every_ms`, each as late as `delays` says.
fn execute(span_ms: i64, every_ms: i64, delays: &[i64]) -> Motion {
    let mut bench = Bench::armed(settings());
    let mut arrivals: Vec<(i64, i64)> = delays
        .iter()
        .zip(0..)
        .map(|(delay_ms, index)| (index * every_ms + delay_ms, index * every_ms))
        .collect();
    arrivals.sort_unstable();
    let mut arrivals = arrivals.into_iter().peekable();
    let end_ms = delays.len() as i64 * every_ms;
    let mut motion = Motion::default();
    for ms in (0..end_ms).step_by(50) {
        while let Some((arrival_ms, stamp_ms)) = arrivals.next_if(|(at_ms, _)| *at_ms <= ms) {
            let chunk = chunk(stamp_ms, 0.02, (span_ms / 200) as usize);
            bench.offer(arrival_ms, &chunk).ok();
            motion.notices += usize::from(bench.step.take_late_notice().is_some());
        }
        motion
            .forward
            .push(sent(bench.tick(ms)).unwrap_or_default());
    }
    motion
}

#[test]
fn chunks_that_are_nearly_over_do_not_move_the_arm() {
    let motion = execute(1_000, 100, &[900; 50]);
    assert_eq!(motion.forward, [0.0; 100]);
    assert_eq!(motion.notices, 1);
}

#[test]
fn chunks_that_are_partly_late_are_executed_without_a_stop() {
    // The next one comes when 0.2 s of the last one are left.
    let motion = execute(1_000, 200, &[600; 50]);
    let going = &motion.forward[14..];
    assert!(going.iter().all(|forward| (forward - 0.1).abs() < 1e-6));
    assert_eq!((motion.starts().len(), motion.notices), (1, 1));
}

#[test]
fn a_short_gap_between_late_chunks_only_slows_the_arm_down() {
    // Each comes 0.1 s after the last one was over.
    let motion = execute(1_000, 500, &[600; 20]);
    assert_eq!(motion.starts().len(), 1, "{motion:?}");
    let going = &motion.forward[16..];
    assert!(going.iter().all(|forward| *forward > 0.04), "{motion:?}");
}

#[test]
fn late_chunks_that_rest_the_arm_are_refused_until_in_time() {
    // Back to back, and each 0.4 s late: the arm would move for 0.6 s and rest for 0.4 s.
    let mut delays = vec![400; 10];
    let motion = execute(1_000, 1_000, &delays);
    assert_eq!((motion.starts().len(), motion.notices), (1, 1));
    let at = motion.forward.iter().rposition(|forward| *forward > 0.0);
    assert!(at.unwrap() < 30, "{motion:?}");
    delays.extend([0; 6]);
    let motion = execute(1_000, 1_000, &delays);
    assert_eq!((motion.starts().len(), motion.notices), (2, 1));
    assert!(motion.forward.last().unwrap() > &0.09);
}

/// Every other chunk comes when it is over: the arm would move and rest in turn.
#[test]
fn chunks_missed_in_turn_do_not_start_and_stop_the_arm() {
    let delays: Vec<i64> = (0..50).map(|index| index % 2 * 550).collect();
    let motion = execute(400, 400, &delays);
    assert!(motion.starts().len() <= 2, "{motion:?}");
    assert_eq!(motion.notices, 1);
}

#[test]
fn one_chunk_after_a_pause_is_executed_although_it_is_late() {
    let mut bench = Bench::armed(settings());
    bench.offer(0, &chunk(0, 0.02, 4)).unwrap();
    bench.run(0, 2_950);
    bench.offer(3_100, &chunk(3_000, 0.02, 4)).unwrap();
    assert!(bench.run(3_100, 3_400).unwrap() > 0.09);
}

#[test]
fn chunks_of_one_action_that_come_a_moment_late_are_executed() {
    let motion = execute(200, 200, &[5; 50]);
    assert_eq!(motion.starts().len(), 1, "{motion:?}");
    assert!(motion.forward[4..].iter().all(|forward| *forward > 0.07));
}

#[test]
fn a_policy_that_stands_still_is_not_to_blame_for_the_pause() {
    let mut bench = Bench::armed(settings());
    for index in 0..20 {
        let ms = index * 200;
        let forward = if index < 10 { 0.0 } else { 0.02 };
        bench.offer(ms + 5, &chunk(ms, forward, 1)).unwrap();
        bench.run(ms + 10, ms + 160);
        bench.tick(ms + 200);
    }
    assert!(bench.run(4_000, 4_000).unwrap() > 0.05);
}

proptest! {
    #[test]
    fn late_chunks_never_make_the_arm_start_and_stop_in_turn(
        span in 1_i64..8,
        every_ms in 50_i64..700,
        most_share in 0.0..1.3_f64,
        shares in prop::collection::vec(0.0..1.0_f64, 400),
    ) {
        let span_ms = span * 200;
        // Chunks keep coming: each overlaps the next one.
        let every_ms = every_ms.min(span_ms);
        let delay = |share: &f64| (share * most_share * span_ms as f64) as i64;
        let delays: Vec<i64> = shares.iter().take((20_000 / every_ms) as usize).map(delay).collect();
        let motion = execute(span_ms, every_ms, &delays);
        let starts = motion.starts();
        // Once a late chunk shows why the arm rested, it rests for 2 s, then for 4 s, and so on.
        prop_assert!(starts.len() <= 8, "{starts:?}");
        for four in starts.windows(4) {
            prop_assert!(four[3] - four[0] >= 40, "{starts:?}");
        }
        prop_assert!(motion.jolt() <= 0.1 + 1e-9);
        prop_assert!(motion.notices <= 1, "{}", motion.notices);
    }
}
