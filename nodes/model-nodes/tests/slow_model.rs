//! A camera that is faster than rollouts: the predictor predicts from every nth frame, and says so.

use std::{collections::BTreeSet, time::Duration};

use crate::running::model::write_model;
use crate::running::{PATIENCE, soon, with_nodes};
use image::{Rgb, RgbImage};
use wm_camera::image_message::encode_image;
use wm_msgs::{
    builtin_interfaces::Time,
    diagnostic_msgs::DiagnosticArray,
    sensor_msgs::Image,
    std_msgs::Header,
    wm_msgs::{Action, Prediction},
};
use wm_ros::{Node, NodeArgs, Publisher, Qos, Subscription};

const START: i64 = 1_700_000_000_000_000_000;
/// Of the camera. A rollout of 64 steps of 20 Euler steps takes longer on any machine.
const PERIOD: Duration = Duration::from_millis(20);
/// Observations that have to be predicted from.
const ENOUGH: usize = 20;

/// The camera and the robot, and what is heard of the nodes.
struct World {
    camera: Publisher<Image>,
    actions: Publisher<Action>,
    predictions: Subscription<Prediction>,
    diagnostics: Subscription<DiagnosticArray>,
    frame: i64,
    /// Stamps of observations that were predicted from \[ns\].
    observed: BTreeSet<i64>,
    skipped: u64,
    overload: u64,
    pace: String,
}

impl World {
    fn show(&mut self) {
        let header = Header {
            stamp: Time::from_nanos(START + self.frame * PERIOD.as_nanos() as i64),
            frame_id: "camera".into(),
        };
        let picture = RgbImage::from_pixel(48, 48, Rgb([90, (self.frame % 200) as u8, 30]));
        let values = vec![0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let action = Action {
            header: header.clone(),
            values,
        };
        self.actions.publish(&action).unwrap();
        self.camera
            .publish(&encode_image(&picture, header))
            .unwrap();
        self.frame += 1;
    }

    fn diagnosed(&mut self, array: DiagnosticArray) {
        let own = |name: &str| name == "wm/predictor";
        let statuses = array.status.into_iter().filter(|status| own(&status.name));
        for pair in statuses.flat_map(|status| status.values) {
            match pair.key.as_str() {
                "skipped: pace [total]" => self.skipped = pair.value.parse().unwrap(),
                "dropped: overload [total]" => self.overload = pair.value.parse().unwrap(),
                "pace" => self.pace = pair.value,
                _ => {}
            }
        }
    }

    async fn watch(&mut self) {
        let mut ticks = tokio::time::interval(PERIOD);
        while self.observed.len() < ENOUGH || self.skipped < ENOUGH as u64 {
            tokio::select! {
                _ = ticks.tick() => self.show(),
                prediction = soon("a prediction", &mut self.predictions) => {
                    self.observed.insert(prediction.observed_stamp.to_nanos());
                }
                Some(received) = self.diagnostics.recv() => self.diagnosed(received.message),
            }
        }
    }
}

#[test]
fn predictor_slower_than_the_camera_skips_frames() {
    let folder = tempfile::tempdir().unwrap();
    write_model(folder.path());
    // Apart from other runs of this test, and from the other tests.
    let model = format!(
        "-p model:={} -p frame_period:={}",
        folder.path().display(),
        PERIOD.as_secs_f64()
    );
    let nodes = [
        (&wm_model_nodes::encoder::NODE, model.clone()),
        (
            &wm_model_nodes::predictor::NODE,
            format!("{model} -p horizon:=64 -p integration_steps:=20"),
        ),
    ];
    with_nodes(&nodes, async |here| {
        let args = NodeArgs::parse(Vec::<String>::new()).unwrap();
        let node = Node::new(here, "world", wm_ros::NAMESPACE, &args).unwrap();
        let many = Qos::best_effort(1000);
        let mut world = World {
            camera: node
                .publisher("/camera/image_raw", Qos::sensor_data())
                .unwrap(),
            actions: node.publisher("action", Qos::reliable(10)).unwrap(),
            predictions: node.subscription("predicted", many).unwrap(),
            diagnostics: node.subscription("/diagnostics", many).unwrap(),
            frame: 0,
            observed: BTreeSet::new(),
            skipped: 0,
            overload: 0,
            pace: String::new(),
        };
        let watched = tokio::time::timeout(PATIENCE, world.watch()).await;
        assert!(
            watched.is_ok(),
            "{} observations predicted from, {} skipped by choice",
            world.observed.len(),
            world.skipped
        );
        // n is known from the start, or after a few rollouts.
        assert!(
            world.overload < world.skipped,
            "{} lost, {} skipped by choice",
            world.overload,
            world.skipped
        );
        assert!(world.pace.starts_with("every ") && world.pace != "every frame");
    });
}
