//! Nodes change to a model of another latent space while they work: predictions and plans go on.

use std::time::Duration;

use crate::running::model::{write_model, write_model_of_seed};
use crate::running::{PATIENCE, with_nodes};
use image::{Rgb, RgbImage};
use wm_camera::image_message::encode_image;
use wm_model_nodes::{encoder, planner, predictor};
use wm_msgs::{
    builtin_interfaces::Time,
    diagnostic_msgs::DiagnosticArray,
    sensor_msgs::Image,
    std_msgs::Header,
    wm_msgs::{Action, Model, Plan, Prediction},
};
use wm_ros::{Context, Node, NodeArgs, Publisher, Qos, Subscription};

const START: i64 = 1_700_000_000_000_000_000;
/// Of the camera.
const PERIOD: Duration = Duration::from_millis(200);
/// Rollouts before and after the change.
const ENOUGH: usize = 8;

/// The camera and the robot, and the outputs of the nodes.
struct World {
    _node: Node,
    camera: Publisher<Image>,
    actions: Publisher<Action>,
    goals: Publisher<Image>,
    models: Publisher<Model>,
    predictions: Subscription<Prediction>,
    plans: Subscription<Plan>,
    diagnostics: Subscription<DiagnosticArray>,
    frame: i64,
    /// Observation and latent space of each rollout, in their order.
    rollouts: Vec<(i64, String)>,
    /// Epochs of the plans.
    epochs: Vec<u64>,
    refused: Vec<String>,
}

fn header(frame: i64) -> Header {
    Header {
        stamp: Time::from_nanos(START + frame * PERIOD.as_nanos() as i64),
        frame_id: "camera".into(),
    }
}

fn picture(frame: i64) -> RgbImage {
    RgbImage::from_fn(48, 48, |x, y| {
        let level = (x as i64 * 5 + frame * 7) % 256;
        Rgb([level as u8, (y * 5) as u8, 30])
    })
}

impl World {
    fn new(context: &Context) -> Self {
        let args = NodeArgs::parse(Vec::<String>::new()).unwrap();
        let node = Node::new(context, "world", wm_ros::NAMESPACE, &args).unwrap();
        let many = Qos::best_effort(100);
        Self {
            camera: node
                .publisher("/camera/image_raw", Qos::reliable(10))
                .unwrap(),
            actions: node.publisher("action", Qos::reliable(10)).unwrap(),
            goals: node.publisher("goal/image", Qos::latched(1)).unwrap(),
            models: node.publisher("model", Qos::latched(1)).unwrap(),
            predictions: node.subscription("predicted", many).unwrap(),
            plans: node.subscription("plan", Qos::reliable(10)).unwrap(),
            diagnostics: node.subscription("/diagnostics", many).unwrap(),
            frame: 0,
            rollouts: Vec::new(),
            epochs: Vec::new(),
            refused: Vec::new(),
            _node: node,
        }
    }

    fn show(&mut self) {
        let header = header(self.frame);
        let action = Action {
            header: header.clone(),
            values: vec![0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        };
        self.actions.publish(&action).unwrap();
        let image = encode_image(&picture(self.frame), header);
        self.camera.publish(&image).unwrap();
        self.frame += 1;
    }

    /// Runs camera and robot until it is so.
    async fn until(&mut self, what: &str, is_so: impl Fn(&Self) -> bool) {
        let mut ticks = tokio::time::interval(PERIOD);
        let run = async {
            while !is_so(self) {
                tokio::select! {
                    _ = ticks.tick() => self.show(),
                    Some(received) = self.predictions.recv() => {
                        let prediction = received.message;
                        if prediction.step == 1 {
                            let observed_ns = prediction.observed_stamp.to_nanos();
                            self.rollouts.push((observed_ns, prediction.latent.space.hash));
                        }
                    }
                    Some(received) = self.plans.recv() => self.epochs.push(received.message.epoch),
                    Some(received) = self.diagnostics.recv() => {
                        let values = received.message.status.into_iter().flat_map(|status| status.values);
                        let refused = values.filter(|value| value.key.contains("wrong_space"));
                        self.refused.extend(refused.map(|value| format!("{}: {}", value.key, value.value)));
                    }
                }
            }
        };
        let is_done = tokio::time::timeout(PATIENCE, run).await.is_ok();
        assert!(
            is_done,
            "{what}: {:?}, plans {:?}",
            self.rollouts, self.epochs
        );
    }

    fn rollouts_of(&self, space: &str) -> usize {
        self.rollouts
            .iter()
            .filter(|(_, hash)| hash == space)
            .count()
    }
}

#[test]
fn predictions_and_plans_go_on_through_a_change_of_the_latent_space() {
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let before = write_model(folders[0].path()).hash;
    let after = write_model_of_seed(folders[1].path(), 5).hash;
    assert_ne!(before, after);
    let common = format!(
        "-p follow_model:=true -p model:={}",
        folders[0].path().display()
    );
    let planner = format!(
        "{common} -p population:=4 -p iterations:=1 -p elites:=2 -p plan_period:=0.4 -p horizon:=2"
    );
    let nodes = [
        (&encoder::NODE, common.clone()),
        (&predictor::NODE, format!("{common} -p horizon:=2")),
        (&planner::NODE, planner),
    ];
    with_nodes(&nodes, async |here| {
        let mut world = World::new(here);
        world
            .goals
            .publish(&encode_image(&picture(500), header(0)))
            .unwrap();
        let has_begun =
            |world: &World| world.rollouts_of(&before) >= ENOUGH && world.epochs.len() >= 2;
        world.until("the first model", has_begun).await;
        let epoch = world.epochs.last().copied().unwrap();
        world
            .models
            .publish(&Model {
                model: folders[1].path().display().to_string(),
                ..Model::default()
            })
            .unwrap();
        let plans_go_on = |world: &World| world.epochs.iter().any(|other| *other > epoch);
        let has_changed = |world: &World| world.rollouts_of(&after) >= ENOUGH && plans_go_on(world);
        world.until("the second model", has_changed).await;

        let first = world.rollouts.iter().position(|(_, hash)| *hash == after);
        let (old, new) = world.rollouts.split_at(first.unwrap());
        assert!(old.iter().all(|(_, hash)| *hash == before));
        assert!(new.iter().all(|(_, hash)| *hash == after));
        let stamps = world.rollouts.iter().map(|(observed_ns, _)| *observed_ns);
        let stamps: Vec<i64> = stamps.collect();
        let period_ns = PERIOD.as_nanos() as i64;
        let gaps: Vec<i64> = stamps
            .windows(2)
            .map(|pair| (pair[1] - pair[0]) / period_ns)
            .collect();
        // The new model may predict from the newest frame again. A busy computer may drop a frame.
        assert!(gaps.iter().all(|gap| *gap <= 2), "{gaps:?}");
        assert_eq!(world.refused, [""; 0]);
    });
}
