use super::*;
use proptest::prelude::*;

const START: u64 = 1_700_000_000_000_000_000;
/// Log times \[ms after the start\] of a bag's messages.
const BAG: [u64; 5] = [0, 200, 400, 600, 1000];

/// Moments are whole nanoseconds, which are up to 10 ns of the bag at these rates.
const ROUNDING_NS: u64 = 10;

fn at(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn bag(ms: u64) -> u64 {
    START + ms * 1_000_000
}

fn plan() -> Plan {
    Plan {
        start_ns: START,
        last_ns: bag(1000),
        is_looping: false,
        delay: Duration::ZERO,
        gap: Duration::ZERO,
        max_gap: None,
    }
}

/// A playback with its bag and its clock, as the player drives it.
struct Run {
    playback: Playback,
    next: usize,
    now: Duration,
    /// Moment and log time \[ms\] of each published message.
    published: Vec<(u64, u64)>,
    /// Moments at which playing began.
    begun: Vec<u64>,
    /// The last message since the last beginning \[ms\].
    last: Option<u64>,
    /// Log times before and after the skipped gaps.
    jumps: Vec<(u64, u64)>,
}

impl Run {
    fn new(plan: Plan, rate: f64, is_paused: bool) -> Self {
        Self {
            playback: Playback::new(plan, rate, is_paused, Duration::ZERO),
            next: 0,
            now: Duration::ZERO,
            published: Vec::new(),
            begun: Vec::new(),
            last: None,
            jumps: Vec::new(),
        }
    }

    fn read_from(&mut self, ns: u64) {
        self.next = BAG.iter().filter(|ms| bag(**ms) < ns).count();
    }

    /// Plays until this moment; returns whether the playback has ended. Between two jumps, no message may be early,
    /// repeated or out of order.
    fn until(&mut self, ms: u64) -> bool {
        loop {
            let next_ns = BAG.get(self.next).map(|ms| bag(*ms));
            match self.playback.step(self.now, next_ns) {
                Step::Publish => {
                    let message = BAG[self.next];
                    let position_ns = self.playback.position_ns(self.now);
                    assert!(position_ns + ROUNDING_NS >= bag(message));
                    assert!(self.last < Some(message));
                    self.last = Some(message);
                    self.published.push((self.now.as_millis() as u64, message));
                    self.next += 1;
                }
                Step::Begin(_) => {
                    self.last = None;
                    self.begun.push(self.now.as_millis() as u64);
                }
                Step::Jump { from_ns, to_ns } => self.jumps.push((from_ns, to_ns)),
                Step::Rewind(ns) => self.read_from(ns),
                Step::Wait(Some(due)) if due <= at(ms) => self.now = due,
                Step::Wait(_) => break,
                Step::Ended => return true,
            }
        }
        self.now = at(ms);
        false
    }

    fn seek(&mut self, ms: u64) {
        let from = self.playback.seek(self.now, bag(ms)).unwrap();
        self.read_from(from);
    }
}

#[test]
fn messages_come_at_their_distances_over_the_rate() {
    let mut run = Run::new(plan(), 2.0, false);
    assert!(!run.until(450));
    assert!(run.until(10_000));
    assert_eq!(
        run.published,
        [(0, 0), (100, 200), (200, 400), (300, 600), (500, 1000)]
    );
    assert_eq!(run.begun, [0]);
}

#[test]
fn longer_gaps_are_jumped_over_and_reported() {
    let plan = Plan {
        start_ns: bag(0) - 3_600_000_000_000,
        max_gap: Some(at(300)),
        ..plan()
    };
    let mut run = Run::new(plan, 1.0, false);
    assert!(run.until(10_000));
    let times = [(0, 0), (200, 200), (400, 400), (600, 600), (600, 1000)];
    assert_eq!(run.published, times);
    assert_eq!(run.jumps, [(plan.start_ns, bag(0)), (bag(600), bag(1000))]);
    // Changed stamps keep a distance, so that nodes detect the jump.
    let plan = Plan {
        gap: at(50),
        max_gap: Some(at(300)),
        ..plan
    };
    let mut run = Run::new(plan, 1.0, false);
    assert!(run.until(10_000));
    assert_eq!(run.published.last(), Some(&(700, 1000)));
}

#[test]
fn messages_after_a_slow_jump_keep_their_distances() {
    let mut run = Run::new(plan(), 1.0, false);
    assert_eq!(run.playback.step(at(0), None), Step::Begin(START));
    run.playback.begin_late(at(700));
    run.now = at(700);
    assert!(run.until(10_000));
    assert_eq!(run.published[..2], [(700, 0), (900, 200)]);
}

#[test]
fn a_round_does_not_wait_for_an_end_without_messages() {
    let plan = Plan {
        last_ns: u64::MAX,
        is_looping: true,
        max_gap: Some(at(500)),
        ..plan()
    };
    let mut run = Run::new(plan, 1.0, false);
    run.until(3500);
    assert_eq!(run.begun, [0, 1500, 3000]);
}

#[test]
fn a_pause_holds_the_time_and_a_resume_goes_on_from_there() {
    let mut run = Run::new(plan(), 1.0, false);
    run.until(300);
    run.playback.pause(run.now);
    assert!(run.playback.is_paused());
    assert!(!run.until(5000));
    assert_eq!(run.playback.position_ns(run.now), bag(300));
    run.playback.resume(run.now);
    assert!(run.until(10_000));
    assert_eq!(run.published[2..], [(5100, 400), (5300, 600), (5700, 1000)]);
}

#[test]
fn a_playback_that_is_paused_at_its_end_does_not_end() {
    let mut run = Run::new(plan(), 1.0, false);
    run.until(900);
    run.playback.pause(run.now);
    run.playback.burst(9);
    assert!(!run.until(60_000));
    assert_eq!((run.next, run.playback.is_bursting()), (5, false));
    run.playback.resume(run.now);
    assert!(run.until(60_000));
}

#[test]
fn another_rate_keeps_the_position() {
    let mut run = Run::new(plan(), 1.0, false);
    run.until(300);
    assert!(run.playback.set_rate(run.now, 0.5));
    assert_eq!(run.playback.position_ns(run.now), bag(300));
    run.until(700);
    assert_eq!(run.published[2], (500, 400));
    assert_eq!(run.playback.position_ns(run.now), bag(500));
    for rate in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9] {
        assert!(!run.playback.set_rate(run.now, rate), "{rate}");
    }
    assert_eq!(run.playback.rate(), 0.5);
    // Also during a pause.
    run.playback.pause(run.now);
    run.playback.set_rate(at(9000), 2.0);
    run.until(9500);
    run.playback.resume(run.now);
    run.until(20_000);
    assert_eq!(run.published[3], (9550, 600));
}

#[test]
fn seeking_goes_forth_and_back() {
    let mut run = Run::new(plan(), 1.0, false);
    run.until(250);
    run.seek(600);
    run.until(300);
    assert_eq!(run.published.last(), Some(&(250, 600)));
    run.seek(100);
    assert_eq!(run.playback.position_ns(run.now), bag(100));
    run.until(450);
    assert_eq!(run.published.last(), Some(&(400, 200)));
    // A time before the beginning means the beginning. A time after the end is refused.
    assert_eq!(run.playback.seek(run.now, 5), Some(START));
    run.read_from(START);
    assert_eq!(run.playback.seek(run.now, bag(1001)), None);
    assert!(run.until(60_000));
    assert_eq!(run.published.last(), Some(&(1450, 1000)));
    assert_eq!(run.begun, [0, 250, 300, 450]);
    // A playback that has ended starts again.
    run.seek(600);
    assert!(!run.until(run.now.as_millis() as u64));
    assert_eq!(run.published.last().map(|last| last.1), Some(600));
}

#[test]
fn a_seek_of_a_paused_playback_leaves_it_paused() {
    let mut run = Run::new(plan(), 1.0, true);
    run.until(50);
    run.seek(400);
    run.until(500);
    assert_eq!(run.playback.position_ns(run.now), bag(400));
    assert_eq!(run.published, []);
    assert!(run.playback.burst(1));
    run.until(600);
    assert_eq!(run.published, [(500, 400)]);
}

#[test]
fn single_messages_and_bursts_need_a_pause() {
    let mut run = Run::new(plan(), 1.0, false);
    run.until(50);
    assert!(!run.playback.burst(1));
    run.playback.pause(run.now);
    assert!(run.playback.burst(1));
    run.until(60);
    assert_eq!(run.published, [(0, 0), (50, 200)]);
    assert_eq!(run.playback.position_ns(run.now), bag(200));
    assert!(run.playback.burst(2));
    run.until(70);
    assert_eq!(run.published[2..], [(60, 400), (60, 600)]);
    run.playback.resume(run.now);
    assert!(run.until(1000));
    assert_eq!(run.published[4], (470, 1000));
    assert!(!run.playback.burst(1), "it is over");
}

#[test]
fn loop_rounds_take_the_bags_length_plus_the_delay() {
    let looping = Plan {
        is_looping: true,
        delay: at(100),
        ..plan()
    };
    let mut run = Run::new(looping, 1.0, false);
    assert!(!run.until(1350));
    assert_eq!(run.begun, [100, 1200]);
    assert_eq!(run.published[5], (1200, 0));
    // The last messages of the bag are not played, but the round is as long as the bag.
    run.next = BAG.len();
    run.until(3000);
    assert_eq!(run.begun, [100, 1200, 2300]);
}

#[test]
fn a_bag_of_a_moment_does_not_loop() {
    let moment = Plan {
        is_looping: true,
        last_ns: START,
        ..plan()
    };
    let mut run = Run::new(moment, 1.0, false);
    assert!(run.until(1000));
    assert_eq!(run.published, [(0, 0)]);
}

#[test]
fn it_ends_with_the_last_message_that_may_be_played() {
    let part = Plan {
        last_ns: bag(600),
        ..plan()
    };
    let mut run = Run::new(part, 1.0, false);
    assert!(run.until(1000));
    assert_eq!(run.published.last(), Some(&(600, 600)));
    assert_eq!(run.playback.seek(run.now, bag(601)), None);
}

#[test]
fn a_stopped_playback_can_be_played_again() {
    let mut run = Run::new(plan(), 1.0, false);
    run.until(300);
    assert!(!run.playback.play(run.now, START, bag(1000)));
    run.playback.stop(run.now);
    assert!(run.until(400));
    assert!(run.playback.play(run.now, bag(300), bag(600)));
    run.read_from(bag(300));
    assert!(run.until(2000));
    assert_eq!(run.published[2..], [(400, 400), (600, 600)]);
}

#[test]
fn clock_starts_after_the_delay_and_goes_back_only_in_jumps() {
    let mut run = Run::new(
        Plan {
            delay: at(500),
            ..plan()
        },
        1.0,
        false,
    );
    run.until(499);
    let clock = |run: &mut Run| {
        let position = run.playback.position_ns(run.now);
        run.playback.clock_ns(position)
    };
    assert_eq!(clock(&mut run), None);
    run.until(800);
    assert_eq!(clock(&mut run), Some(bag(300)));
    assert_eq!(
        run.playback.clock_ns(bag(200)),
        Some(bag(300)),
        "a message that is late does not turn it back"
    );
    run.seek(0);
    run.until(850);
    assert_eq!(clock(&mut run), Some(bag(50)));
    assert!(run.until(9000));
    assert_eq!(clock(&mut run), None);
}

#[test]
fn a_gap_follows_a_jump_and_stamps_go_on_after_it() {
    let gaped = Plan {
        is_looping: true,
        gap: at(1500),
        ..plan()
    };
    let mut run = Run::new(gaped, 1.0, false);
    run.until(2500);
    assert_eq!(run.begun, [0, 2500]);
    // The stamp is 30 ms before its message, in the second round.
    assert_eq!(run.playback.moment_ns(bag(170) as i64), 2_670_000_000);
    run.until(2600);
    run.seek(400);
    run.until(4100);
    assert_eq!(run.begun, [0, 2500, 4100]);
}

#[test]
fn stamps_keep_their_distances() {
    let mut playback = Playback::new(plan(), 1.0, false, at(50));
    let start = START as i64;
    assert_eq!(playback.moment_ns(start + 200_000_001), 250_000_001);
    assert_eq!(playback.moment_ns(start - 10), 49_999_990);
    playback.step(at(50), Some(START));
    playback.set_rate(at(50), 2.0);
    assert_eq!(playback.moment_ns(start + 200), 50_000_100);
}

#[derive(Clone, Debug)]
enum UserRequest {
    Pause,
    Resume,
    Rate(f64),
    Burst(u64),
    Seek(u64),
    Stop,
    Play(u64, u64),
    Pass(u64),
}

fn user_request() -> impl Strategy<Value = UserRequest> {
    prop_oneof![
        Just(UserRequest::Pause),
        Just(UserRequest::Resume),
        (0.1..10.0).prop_map(UserRequest::Rate),
        (0_u64..4).prop_map(UserRequest::Burst),
        (0_u64..1100).prop_map(UserRequest::Seek),
        Just(UserRequest::Stop),
        (0_u64..600, 600_u64..1000).prop_map(|(from, to)| UserRequest::Play(from, to)),
        (1_u64..700).prop_map(UserRequest::Pass),
    ]
}

proptest! {
    /// For any requests: the playback never hangs, messages are in order and never early ([`Run::until`]), and the
    /// clock goes back only in jumps.
    #[test]
    fn any_requests_keep_order_and_time(requests in prop::collection::vec(user_request(), 1..40), is_looping in any::<bool>()) {
        let mut run = Run::new(Plan { is_looping, ..plan() }, 1.0, false);
        let mut clock = 0;
        for request in requests {
            let now = run.now;
            let rounds = run.begun.len();
            match request {
                UserRequest::Pause => run.playback.pause(now),
                UserRequest::Resume => run.playback.resume(now),
                UserRequest::Rate(rate) => prop_assert!(run.playback.set_rate(now, rate)),
                UserRequest::Burst(messages) => { run.playback.burst(messages); }
                UserRequest::Seek(ms) => if let Some(from) = run.playback.seek(now, bag(ms)) {
                    run.read_from(from);
                },
                UserRequest::Stop => run.playback.stop(now),
                UserRequest::Play(from, to) => if run.playback.play(now, bag(from), bag(to)) {
                    run.read_from(bag(from));
                },
                UserRequest::Pass(ms) => {
                    run.until(now.as_millis() as u64 + ms);
                    run.now = now + at(ms);
                }
            }
            if run.begun.len() > rounds {
                clock = 0;
            }
            let position = run.playback.position_ns(run.now);
            if let Some(clock_ns) = run.playback.clock_ns(position) {
                prop_assert!(clock_ns >= clock && clock_ns <= bag(1000));
                clock = clock_ns;
            }
        }
    }
}
