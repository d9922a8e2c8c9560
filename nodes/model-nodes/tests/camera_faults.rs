//! Encoder, predictor and planner before a camera that stops, repeats itself or has a wrong clock, and the node views before
//! two cameras: over real DDS on loopback, in real time, with small random weights.

mod several;

use std::{collections::BTreeMap, time::Duration};

use crate::running::model::write_model;
use crate::running::{PATIENCE, with_nodes};
use image::{Rgb, RgbImage};
use tokio::time::{Instant, Interval};
use wm_camera::image_message::{encode_image, encode_jpeg};
use wm_msgs::{
    builtin_interfaces::Time,
    diagnostic_msgs::{DiagnosticArray, DiagnosticStatus},
    sensor_msgs::{CompressedImage, Image},
    std_msgs::Header,
    wm_msgs::{Action, CameraState, Plan, Prediction},
};
use wm_ros::{Context, Node, NodeArgs, Publisher, Qos, Subscription};

/// From one frame to the next.
const PERIOD: Duration = Duration::from_millis(100);
/// Side of the camera's image \[px\].
const SIDE: u32 = 48;
/// Frames for which nothing may come that must not come.
const QUIET: i64 = 15;

/// What the camera does.
#[derive(Clone, Copy, Default)]
struct Camera {
    has_stopped: bool,
    /// Each picture is published so many times, beyond the first.
    copies: i64,
    /// By how much its clock is ahead \[ns\].
    ahead_ns: i64,
}

fn picture(index: i64, noise: i64) -> RgbImage {
    RgbImage::from_fn(SIDE, SIDE, |x, y| {
        let ball = (i64::from(x) - (4 * index).rem_euclid(i64::from(SIDE))).abs() < 6
            && y.abs_diff(20) < 6;
        let place = (u64::from(x) << 40) | (u64::from(y) << 20);
        let mixed = (place ^ noise.unsigned_abs()).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        // As if it were one grey level more or less.
        let noisy = (mixed >> 33) as u8 % 3;
        match ball {
            true => Rgb([220, 40, 40 + noisy]),
            false => Rgb([90, (2 * x) as u8 + noisy, (3 * y) as u8 + noisy]),
        }
    })
}

/// The robot and its camera, and all that the nodes publish.
struct World {
    node: Node,
    ticks: Interval,
    begin_ns: i64,
    index: i64,
    camera: Publisher<Image>,
    actions: Publisher<Action>,
    goals: Publisher<CompressedImage>,
    states: Subscription<CameraState>,
    predictions: Subscription<Prediction>,
    plans: Subscription<Plan>,
    diagnostics: Subscription<DiagnosticArray>,
    seen: Seen,
}

/// The newest of all.
#[derive(Default)]
struct Seen {
    state: CameraState,
    prediction: Prediction,
    plan: Plan,
    statuses: BTreeMap<String, DiagnosticStatus>,
}

impl Seen {
    fn says(&self, name: &str, level: u8, text: &str) -> bool {
        let status = self.statuses.get(name);
        status.is_some_and(|status| status.level == level && status.message.contains(text))
    }

    fn total(&self, node: &str, key: &str) -> u64 {
        let values = self.statuses.get(node).map(|status| &status.values);
        let mut values = values.into_iter().flatten();
        let found = values.find(|pair| pair.key == format!("{key} [total]"));
        found.map_or(0, |pair| pair.value.parse().unwrap())
    }
}

impl World {
    async fn new(context: &Context) -> Self {
        let args = NodeArgs::parse(Vec::<String>::new()).unwrap();
        let node = Node::new(context, "world", wm_ros::NAMESPACE, &args).unwrap();
        let many = Qos::reliable(1000);
        let mut world = Self {
            ticks: tokio::time::interval(PERIOD),
            begin_ns: node.now().to_nanos(),
            index: 0,
            camera: node
                .publisher("/camera/image_raw", Qos::reliable(10))
                .unwrap(),
            actions: node.publisher("action", Qos::reliable(10)).unwrap(),
            goals: node
                .publisher("goal/image/compressed", Qos::latched(1))
                .unwrap(),
            states: node.subscription("camera_state", many).unwrap(),
            predictions: node.subscription("predicted", many).unwrap(),
            plans: node.subscription("plan", many).unwrap(),
            diagnostics: node.subscription("/diagnostics", many).unwrap(),
            seen: Seen::default(),
            node,
        };
        let met = async {
            world.camera.wait_for_subscribers(1).await;
            // Of encoder, predictor and planner.
            world.actions.wait_for_subscribers(3).await;
            world.goals.wait_for_subscribers(1).await;
            world.states.wait_for_publishers(1).await;
            world.predictions.wait_for_publishers(1).await;
            world.plans.wait_for_publishers(1).await;
        };
        tokio::time::timeout(PATIENCE, met)
            .await
            .expect("the nodes did not meet");
        (world.ticks, world.begin_ns) =
            (tokio::time::interval(PERIOD), world.node.now().to_nanos());
        world
    }

    /// A moment of the robot: an action and a frame; takes what the nodes have published. Gives the frame's stamp.
    async fn moment(&mut self, camera: Camera) -> Time {
        // Ticks that are late come at once: stamps are evenly spaced, and never ahead of the clock.
        self.ticks.tick().await;
        let now_ns = self.begin_ns + self.index * i64::try_from(PERIOD.as_nanos()).unwrap();
        let header = |frame_id: &str, stamp_ns| Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: frame_id.into(),
        };
        let action = Action {
            header: header("base_link", now_ns),
            values: vec![0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        };
        self.actions.publish(&action).unwrap();
        let shown = match camera {
            Camera {
                has_stopped: true, ..
            } => 0,
            Camera { copies, .. } => self.index / (copies + 1),
        };
        let noise = if camera.copies > 0 { shown } else { self.index };
        let header = header("camera", now_ns + camera.ahead_ns);
        let stamp = header.stamp;
        self.camera
            .publish(&encode_image(&picture(shown, noise), header))
            .unwrap();
        self.index += 1;
        while let Some(received) = self.states.try_recv() {
            self.seen.state = received.message;
        }
        while let Some(received) = self.predictions.try_recv() {
            self.seen.prediction = received.message;
        }
        while let Some(received) = self.plans.try_recv() {
            self.seen.plan = received.message;
        }
        while let Some(received) = self.diagnostics.try_recv() {
            let statuses = received.message.status.into_iter();
            self.seen
                .statuses
                .extend(statuses.map(|status| (status.name.clone(), status)));
        }
        stamp
    }

    async fn until(&mut self, what: &str, camera: Camera, is_so: impl Fn(&Seen) -> bool) {
        let end = Instant::now() + PATIENCE;
        while !is_so(&self.seen) {
            assert!(
                Instant::now() < end,
                "{what}: {:?}, {:#?}",
                self.seen.state,
                self.seen.statuses
            );
            self.moment(camera).await;
        }
    }

    /// Until plans come from frames from now on.
    async fn plans_come(&mut self, camera: Camera) {
        let stamp = self.moment(camera).await;
        self.until("a plan", camera, |seen| seen.plan.header.stamp >= stamp)
            .await;
    }

    /// From now on no plan comes.
    async fn no_plan_comes(&mut self, camera: Camera) {
        let stamp = self.moment(camera).await;
        for _ in 0..QUIET {
            self.moment(camera).await;
        }
        let plan = self.seen.plan.header.stamp;
        assert!(plan < stamp, "a plan of {plan:?}, after {stamp:?}");
    }
}

#[test]
fn faulty_cameras_are_named_and_not_planned_from() {
    let folder = tempfile::tempdir().unwrap();
    write_model(folder.path());
    let model = format!(
        "-p model:={} -p frame_period:={}",
        folder.path().display(),
        PERIOD.as_secs_f64()
    );
    let planner =
        "-p population:=12 -p iterations:=2 -p elites:=4 -p horizon:=2 -p plan_period:=0.2";
    let nodes = [
        (&wm_model_nodes::encoder::NODE, model.clone()),
        (
            &wm_model_nodes::predictor::NODE,
            format!("{model} -p horizon:=2"),
        ),
        (&wm_model_nodes::planner::NODE, format!("{model} {planner}")),
    ];
    with_nodes(&nodes, async |here| {
        let mut world = World::new(here).await;
        let goal = encode_jpeg(&picture(5, 0), Header::default(), 95).unwrap();
        world.goals.publish(&goal).unwrap();
        world.plans_come(Camera::default()).await;
        stopped(&mut world).await;
        repeating(&mut world).await;
        ahead(&mut world).await;
        stepped(&mut world).await;
    });
}

/// The same picture but for its noise, with fresh stamps, while the arm moves.
async fn stopped(world: &mut World) {
    let stopped = Camera {
        has_stopped: true,
        ..Camera::default()
    };
    assert!(!world.seen.state.frozen, "{:?}", world.seen.state);
    world
        .until("it is frozen", stopped, |seen| seen.state.frozen)
        .await;
    let reason = &world.seen.state.reason;
    assert!(reason.contains("the arm has moved"), "{reason}");
    world.no_plan_comes(stopped).await;
    let error = DiagnosticStatus::ERROR;
    for name in [
        "wm/encoder: camera",
        "wm/predictor: trust",
        "wm/planner: camera",
    ] {
        let is_said = |seen: &Seen| seen.says(name, error, "the camera has stopped");
        world.until(name, stopped, is_said).await;
    }
    let dropped = |seen: &Seen| seen.total("wm/planner", "dropped: frozen_camera") > 1;
    world.until("plans are dropped", stopped, dropped).await;
    assert!(world.seen.state.frozen);
    world.plans_come(Camera::default()).await;
    assert!(!world.seen.state.frozen);
}

/// Each picture twice.
async fn repeating(world: &mut World) {
    let twice = Camera {
        copies: 1,
        ..Camera::default()
    };
    let is_half = |seen: &Seen| {
        let (rate, distinct) = (seen.state.rate, seen.state.distinct_rate);
        (rate - 10.0).abs() < 1.0 && (distinct - 5.0).abs() < 1.0
    };
    world.until("half the rate", twice, is_half).await;
    let name = "wm/encoder: camera rate";
    let is_said =
        |seen: &Seen| seen.says(name, DiagnosticStatus::WARN, "but only 5 of them differ");
    world.until(name, twice, is_said).await;
    assert!(!world.seen.state.frozen);
    world.plans_come(Camera::default()).await;
}

/// The camera's clock is 1.2 s ahead.
async fn ahead(world: &mut World) {
    let ahead = Camera {
        ahead_ns: 1_200_000_000,
        ..Camera::default()
    };
    let name = "wm/encoder: stamps";
    let is_said = |seen: &Seen| {
        let text = "s ahead of this node's clock";
        let level = DiagnosticStatus::ERROR;
        seen.says(name, level, text)
            && (seen.says(name, level, "stamped 1.1") || seen.says(name, level, "stamped 1.2"))
    };
    world.until(name, ahead, is_said).await;
    world.no_plan_comes(ahead).await;
    world.plans_come(Camera::default()).await;
}

/// The camera's clock wraps at 32 bits of milliseconds, and comes back.
async fn stepped(world: &mut World) {
    let wrapped = Camera {
        ahead_ns: -4_294_967_296_000_000,
        ..Camera::default()
    };
    let epoch = world.seen.prediction.epoch;
    let begun = |seen: &Seen| seen.prediction.epoch > epoch;
    world
        .until("predictions of a new epoch", wrapped, begun)
        .await;
    let text = "the camera's clock stepped back by 42949";
    for name in ["wm/predictor: trust", "wm/planner: camera clock"] {
        let is_said = |seen: &Seen| seen.says(name, DiagnosticStatus::ERROR, text);
        world.until(name, wrapped, is_said).await;
    }
    let plan = world.seen.plan.header.stamp;
    for _ in 0..QUIET {
        world.moment(wrapped).await;
    }
    assert_eq!(
        world.seen.plan.header.stamp, plan,
        "a plan by a wrong clock"
    );
    world.plans_come(Camera::default()).await;
}
