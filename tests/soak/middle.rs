//! Between the arm and the suite: pictures and the clock pass through here, or do not.

use std::{
    cell::{Cell, RefCell},
    rc::Rc,
    time::Duration,
};

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use wm_msgs::{builtin_interfaces::Time, rosgraph_msgs::Clock, sensor_msgs::Image};
use wm_ros::{Node, Publisher, Qos};

/// Where the arm publishes its pictures, for this alone.
pub const TRUE_CAMERA: &str = "/soak/image_raw";
/// Time from one message on `/clock` to the next.
const CLOCK_PERIOD: Duration = Duration::from_millis(20);

/// Which pictures pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pictures {
    /// All, as they are.
    Live,
    /// The last one, with the stamps of the others.
    Frozen,
    /// The same, and noise of one grey level.
    FrozenNoise,
    /// None.
    Silent,
}

/// The man in the middle.
pub struct Middle {
    pictures: Cell<Pictures>,
    last: RefCell<Option<Image>>,
    is_clock_running: Cell<bool>,
    /// By how much the clock is late \[ns\].
    behind_ns: Cell<i64>,
    images: Publisher<Image>,
    clock: Publisher<Clock>,
}

impl Middle {
    /// All passes.
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

    /// Passes on from now on.
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

    fn pass(&self, mut image: Image, rng: &mut ChaCha8Rng) {
        // Its stamps are those of the clock, if that runs.
        let stamp_ns = image.header.stamp.to_nanos() - self.behind_ns.get();
        image.header.stamp = Time::from_nanos(stamp_ns);
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

    /// Chooses the pictures.
    pub fn show(&self, pictures: Pictures) {
        self.pictures.set(pictures);
    }

    /// `/clock` falls silent.
    pub fn stop_clock(&self) {
        self.is_clock_running.set(false);
    }

    /// `/clock` goes on, later than real time by so much more.
    pub fn run_clock(&self, behind: Duration) {
        let behind_ns = i64::try_from(behind.as_nanos()).unwrap_or(0);
        self.behind_ns.set(self.behind_ns.get() + behind_ns);
        self.is_clock_running.set(true);
    }
}
