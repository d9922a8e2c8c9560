//! Relays pictures, poses, actions and the clock between the arm and the suite, or blocks them. Stamps follow the
//! suite's clock.

use std::{
    cell::{Cell, RefCell},
    rc::Rc,
    time::Duration,
};

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use wm_msgs::{
    Message, builtin_interfaces::Time, geometry_msgs::PoseStamped, rosgraph_msgs::Clock,
    sensor_msgs::Image, wm_msgs::Action,
};
use wm_ros::{Node, Publisher, Qos};

/// The arm's topics, which only this relay reads.
pub const TRUE_CAMERA: &str = "/soak/image_raw";
/// See [`TRUE_CAMERA`].
pub const TRUE_POSE: &str = "/soak/ee_pose";
/// See [`TRUE_CAMERA`].
pub const TRUE_ACTION: &str = "/soak/action";
/// Time between messages on `/clock`.
const CLOCK_PERIOD: Duration = Duration::from_millis(20);

/// The relayed pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pictures {
    /// All, unchanged.
    Live,
    /// The last one, with new stamps.
    Frozen,
    /// The last one, with new stamps and a noise of one grey level.
    FrozenNoise,
    /// None.
    Silent,
}

/// The relay.
pub struct Middle {
    pictures: Cell<Pictures>,
    last: RefCell<Option<Image>>,
    is_clock_running: Cell<bool>,
    /// How late the suite's clock is \[ns\].
    behind_ns: Cell<i64>,
    images: Publisher<Image>,
    clock: Publisher<Clock>,
}

impl Middle {
    /// Relays everything.
    pub fn new(node: &Node) -> Self {
        Self {
            pictures: Cell::new(Pictures::Live),
            last: RefCell::new(None),
            is_clock_running: Cell::new(true),
            behind_ns: Cell::new(0),
            images: node
                .publisher("/camera/image_raw", Qos::reliable(2))
                .expect("a publisher"),
            clock: node
                .publisher("/clock", Qos::reliable(1))
                .expect("a publisher"),
        }
    }

    /// Starts relaying.
    pub fn spawn(self: &Rc<Self>, node: &Node) {
        let mut true_images = node
            .subscription::<Image>(TRUE_CAMERA, Qos::reliable(2))
            .expect("a subscription");
        let middle = Rc::clone(self);
        tokio::task::spawn_local(async move {
            let mut rng = ChaCha8Rng::seed_from_u64(0);
            while let Some(received) = true_images.recv().await {
                middle.pass(received.message, &mut rng);
            }
        });
        self.relay(node, TRUE_POSE, "ee_pose", |pose: &mut PoseStamped| {
            &mut pose.header.stamp
        });
        self.relay(node, TRUE_ACTION, "action", |action: &mut Action| {
            &mut action.header.stamp
        });
        let (middle, node) = (Rc::clone(self), node.clone());
        tokio::task::spawn_local(async move {
            let mut beat = tokio::time::interval(CLOCK_PERIOD);
            loop {
                beat.tick().await;
                if middle.is_clock_running.get() {
                    let now_ns = node.now().to_nanos() - middle.behind_ns.get();
                    let clock = Time::from_nanos(now_ns);
                    middle.clock.publish(&Clock { clock }).ok();
                }
            }
        });
    }

    fn relay<M: Message>(
        self: &Rc<Self>,
        node: &Node,
        from: &str,
        to: &str,
        stamp: fn(&mut M) -> &mut Time,
    ) {
        let qos = Qos::reliable(10);
        let mut received = node.subscription::<M>(from, qos).expect("a subscription");
        let publisher = node.publisher::<M>(to, qos).expect("a publisher");
        let middle = Rc::clone(self);
        tokio::task::spawn_local(async move {
            while let Some(received) = received.recv().await {
                let mut message = received.message;
                let stamp = stamp(&mut message);
                *stamp = middle.in_suite_time(*stamp);
                publisher.publish(&message).ok();
            }
        });
    }

    /// Converts a stamp of the arm to the suite's clock.
    fn in_suite_time(&self, stamp: Time) -> Time {
        Time::from_nanos(stamp.to_nanos() - self.behind_ns.get())
    }

    fn pass(&self, mut image: Image, rng: &mut ChaCha8Rng) {
        image.header.stamp = self.in_suite_time(image.header.stamp);
        let mut last = self.last.borrow_mut();
        match (self.pictures.get(), &*last) {
            (Pictures::Silent, _) => return,
            (Pictures::Frozen, Some(last)) => image.data.clone_from(&last.data),
            (Pictures::FrozenNoise, Some(last)) => {
                image.data.clone_from(&last.data);
                for value in &mut image.data {
                    *value = value.saturating_add_signed(rng.random_range(-1..=1));
                }
            }
            (Pictures::Live, _) | (_, None) => *last = Some(image.clone()),
        }
        self.images.publish(&image).ok();
    }

    pub fn show(&self, pictures: Pictures) {
        self.pictures.set(pictures);
    }

    /// Stops `/clock`.
    pub fn stop_clock(&self) {
        self.is_clock_running.set(false);
    }

    /// Continues `/clock`, later than real time by a further `behind`.
    pub fn run_clock(&self, behind: Duration) {
        let behind_ns = i64::try_from(behind.as_nanos()).unwrap_or(0);
        self.behind_ns.set(self.behind_ns.get() + behind_ns);
        self.is_clock_running.set(true);
    }
}
