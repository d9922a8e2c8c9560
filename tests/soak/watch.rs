//! Records the commands and the motion of the arm.

use std::{
    cell::{Cell, RefCell},
    collections::BTreeMap,
    rc::Rc,
    time::{Duration, Instant},
};

use tokio::sync::Notify;
use wm_msgs::{
    diagnostic_msgs::DiagnosticArray,
    geometry_msgs::{PoseStamped, TwistStamped},
    wm_msgs::ExecutorStatus,
};
use wm_ros::{Node, Qos};

use crate::{balance::Totals, middle::TRUE_POSE};

/// How long the arm executes a command \[s\].
const HOLDS_S: f64 = 0.5;
/// A slower arm rests \[m/s\].
const STILL: f64 = 1e-4;

/// The commanded and the actual motion of an arm during a fault.
#[derive(Clone, Copy, Debug, Default)]
pub struct Motion {
    /// The sum of its commands, each until the next one \[m\].
    pub commanded_m: f64,
    /// When the last moving command arrived \[s\].
    pub commanded_s: f64,
    /// How far the tool moved \[m\].
    pub moved_m: f64,
    /// When it last moved \[s\].
    pub moved_s: f64,
}

pub struct Watch {
    begin: Cell<Instant>,
    /// Commands since the fault began: time and speed \[m/s\].
    twists: RefCell<Vec<(Instant, f64)>>,
    /// Poses since then, and the previous one.
    poses: RefCell<Vec<(Instant, [f64; 3])>>,
    reason: RefCell<String>,
    /// Totals of drops by node and reason, over restarts.
    drops: RefCell<BTreeMap<(String, String), Total>>,
    news: Notify,
}

/// A counter that restarts with its process.
#[derive(Clone, Copy, Debug, Default)]
struct Total {
    sum: u64,
    last: u64,
}

impl Watch {
    pub fn new() -> Self {
        Self {
            begin: Cell::new(Instant::now()),
            twists: RefCell::default(),
            poses: RefCell::default(),
            reason: RefCell::default(),
            drops: RefCell::default(),
            news: Notify::new(),
        }
    }

    /// Starts recording.
    pub fn spawn(self: &Rc<Self>, node: &Node) {
        let depth = Qos::best_effort(1_000);
        let mut twists = node
            .subscription::<TwistStamped>("command/twist", depth)
            .expect("a subscription");
        let watch = Rc::clone(self);
        tokio::task::spawn_local(async move {
            while let Some(received) = twists.recv().await {
                let linear = received.message.twist.linear;
                let speed = linear.x.hypot(linear.y).hypot(linear.z);
                watch.twists.borrow_mut().push((received.at, speed));
                watch.news.notify_waiters();
            }
        });
        let mut poses = node
            .subscription::<PoseStamped>(TRUE_POSE, depth)
            .expect("a subscription");
        let watch = Rc::clone(self);
        tokio::task::spawn_local(async move {
            while let Some(received) = poses.recv().await {
                let at = received.message.pose.position;
                let place = (received.at, [at.x, at.y, at.z]);
                watch.poses.borrow_mut().push(place);
            }
        });
        let mut status = node
            .subscription::<ExecutorStatus>("executor/status", Qos::reliable(10))
            .expect("a subscription");
        let watch = Rc::clone(self);
        tokio::task::spawn_local(async move {
            while let Some(received) = status.recv().await {
                watch.reason.replace(received.message.reason);
            }
        });
        let mut diagnostics = node
            .subscription::<DiagnosticArray>("/diagnostics", Qos::reliable(100))
            .expect("a subscription");
        let watch = Rc::clone(self);
        tokio::task::spawn_local(async move {
            while let Some(received) = diagnostics.recv().await {
                watch.count(&received.message);
            }
        });
    }

    fn count(&self, diagnostics: &DiagnosticArray) {
        let mut drops = self.drops.borrow_mut();
        for status in &diagnostics.status {
            for pair in &status.values {
                let counted = ["dropped: ", "sent ", "received "];
                let key = pair
                    .key
                    .strip_suffix(" [total]")
                    .filter(|key| counted.iter().any(|prefix| key.starts_with(prefix)));
                let (Some(key), Ok(value)) = (key, pair.value.parse::<u64>()) else {
                    continue;
                };
                let total = drops
                    .entry((status.name.clone(), key.to_owned()))
                    .or_default();
                total.sum += value.checked_sub(total.last).unwrap_or(value);
                total.last = value;
            }
        }
    }

    /// A process was restarted: its counters begin at 0.
    pub fn restarted(&self, node: &str) {
        let name = format!("wm/{node}");
        for ((of, _), total) in &mut *self.drops.borrow_mut() {
            if *of == name {
                total.last = 0;
            }
        }
    }

    /// The speed that the arm is commanded to have now \[m/s\].
    pub fn speed(&self) -> f64 {
        let twists = self.twists.borrow();
        let is_new = |at: &Instant| at.elapsed().as_secs_f64() < HOLDS_S;
        let newest = twists.last().filter(|(at, _)| is_new(at));
        newest.map_or(0.0, |(_, speed)| *speed)
    }

    /// Waits for the next command.
    pub async fn changed(&self) {
        self.news.notified().await;
    }

    /// A fault begins: keeps the last command and pose.
    pub fn begin(&self) {
        self.begin.set(Instant::now());
        let mut twists = self.twists.borrow_mut();
        let old = twists.len().saturating_sub(1);
        twists.drain(..old);
        let mut poses = self.poses.borrow_mut();
        let old = poses.len().saturating_sub(1);
        poses.drain(..old);
    }

    /// The commanded and actual motion since the fault began, `span` ago.
    pub fn motion(&self, span: Duration) -> Motion {
        let begin = self.begin.get();
        let since = |at: Instant| at.saturating_duration_since(begin).as_secs_f64();
        let mut motion = Motion::default();
        let twists = self.twists.borrow();
        for (index, (at, speed)) in twists.iter().enumerate() {
            let next = twists
                .get(index + 1)
                .map_or(span.as_secs_f64(), |(at, _)| since(*at));
            let from = since(*at);
            motion.commanded_m += speed * (next - from).clamp(0.0, HOLDS_S);
            if *speed > STILL && *at > begin {
                motion.commanded_s = from;
            }
        }
        let poses = self.poses.borrow();
        for ((before, from), (at, to)) in poses.iter().zip(poses.iter().skip(1)) {
            let way = from
                .iter()
                .zip(to)
                .map(|(a, b)| (b - a) * (b - a))
                .sum::<f64>();
            let seconds = at.saturating_duration_since(*before).as_secs_f64();
            let metres = way.sqrt();
            motion.moved_m += metres;
            if metres > STILL * seconds.max(0.1) {
                motion.moved_s = since(*at);
            }
        }
        motion
    }

    /// The executor's last reason.
    pub fn reason(&self) -> String {
        self.reason.borrow().clone()
    }

    /// Sent, received and dropped messages by node and reason, over all restarts.
    pub fn totals(&self) -> Totals {
        let mut totals = Totals::new();
        for ((node, key), total) in &*self.drops.borrow() {
            if total.sum > 0 {
                let of_node = totals.entry(node.clone()).or_default();
                of_node.insert(key.clone(), total.sum);
            }
        }
        totals
    }
}
