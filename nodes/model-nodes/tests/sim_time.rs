//! A predictor that goes by `/clock`: where the clock jumps back, as when a bag begins again, what was observed before is
//! forgotten.

use crate::{fresh_domain::fresh_domain, running::quiet};
use std::time::Duration;

use wm_model::{LatentSpace, trained_folder::EMBEDDED};
use wm_msgs::{
    builtin_interfaces::Time,
    diagnostic_msgs::DiagnosticArray,
    rosgraph_msgs::Clock,
    std_msgs::Header,
    wm_msgs::{Action, Latent, Prediction},
};
use wm_ros::{
    Context, Environment, Middleware, Node, NodeArgs, Publisher, Qos, Reach, Subscription,
};
use wm_wire::latent_message::{LatentDtype, encode_latent};
use wm_zoo::ModelFolder;

/// Far above anything that happens here; it only ends a test that hangs.
const PATIENCE: Duration = Duration::from_secs(60);
/// The camera's period \[ns\].
const PERIOD: i64 = 200_000_000;
/// The bag begins here, and begins again here \[s\].
const START_S: i64 = 1_700_000_000;

fn node(domain_id: u16, name: &str, line: &str) -> (Context, Node) {
    let environment = Environment {
        domain_id,
        reach: Reach::Localhost,
        middleware: Middleware::from_env().unwrap(),
    };
    let context = Context::new(&environment).unwrap();
    let args = NodeArgs::parse(line.split_whitespace()).unwrap();
    let node = Node::new(&context, name, wm_ros::NAMESPACE, &args).unwrap();
    (context, node)
}

fn header(index: i64) -> Header {
    Header {
        stamp: Time::from_nanos(START_S * 1_000_000_000 + index * PERIOD),
        frame_id: "camera".into(),
    }
}

struct World {
    space: LatentSpace,
    clock: Publisher<Clock>,
    latents: Publisher<Latent>,
    actions: Publisher<Action>,
    predictions: Subscription<Prediction>,
    diagnostics: Subscription<DiagnosticArray>,
}

impl World {
    fn moment(&self, index: i64) {
        let action = Action {
            header: header(index),
            values: vec![0.0; 7],
        };
        self.actions.publish(&action).unwrap();
        let values = vec![0.25; self.space.elements()];
        let latent = encode_latent(&values, &self.space, LatentDtype::F16, header(index)).unwrap();
        self.latents.publish(&latent).unwrap();
    }

    /// Tells the clock until the predictor's own reports carry that time.
    async fn tell(&mut self, seconds: i64) {
        let clock = Time::from_nanos((START_S + seconds) * 1_000_000_000);
        loop {
            self.clock.publish(&Clock { clock }).unwrap();
            let report = self.diagnostics.recv().await.unwrap().message;
            let is_of_predictor = report.status[0].name == "wm/predictor";
            if is_of_predictor && report.header.stamp == clock {
                return;
            }
        }
    }

    async fn said(&mut self, text: &str) {
        loop {
            let report = self.diagnostics.recv().await.unwrap().message;
            let status = &report.status[0];
            if status.name == "wm/predictor" && status.message.contains(text) {
                return;
            }
        }
    }
}

#[tokio::test(flavor = "current_thread")]
async fn a_clock_that_jumps_back_flushes_the_history() {
    let _quiet = quiet();
    let domain = fresh_domain();
    let (predictor_context, predictor) =
        node(domain, "predictor", "--ros-args -p use_sim_time:=true");
    let thread = std::thread::spawn(move || {
        tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .unwrap()
            .block_on((wm_model_nodes::predictor::NODE.body)(predictor))
    });
    let (here, node) = node(domain, "world", "");
    let mut world = World {
        space: ModelFolder::open(EMBEDDED).unwrap().space().unwrap(),
        clock: node.publisher("/clock", Qos::reliable(1)).unwrap(),
        latents: node.publisher("latent", Qos::reliable(10)).unwrap(),
        actions: node.publisher("action", Qos::reliable(10)).unwrap(),
        predictions: node
            .subscription("predicted", Qos::best_effort(100))
            .unwrap(),
        diagnostics: node
            .subscription("/diagnostics", Qos::reliable(100))
            .unwrap(),
    };
    let scenario = async {
        world.clock.wait_for_subscribers(1).await;
        world.latents.wait_for_subscribers(1).await;
        world.actions.wait_for_subscribers(1).await;
        world.predictions.wait_for_publishers(1).await;
        world.tell(60).await;
        // A model step is two frames: three make the context of two.
        for index in 298..=300 {
            world.moment(index);
        }
        let prediction = world.predictions.recv().await.unwrap().message;
        assert_eq!(prediction.observed_stamp, header(300).stamp);

        world.tell(0).await;
        world.moment(0);
        world.said("1 of 2 context frames have arrived").await;
        world.tell(1).await;
        world.moment(1);
        world.moment(2);
        loop {
            let prediction = world.predictions.recv().await.unwrap().message;
            if prediction.observed_stamp != header(300).stamp {
                assert_eq!(prediction.observed_stamp, header(2).stamp);
                break;
            }
        }
    };
    tokio::time::timeout(PATIENCE, scenario)
        .await
        .expect("the predictor does not go by the clock");
    drop((world, node));
    here.close();
    predictor_context.shutdown().trigger();
    thread.join().unwrap().unwrap();
    predictor_context.close();
}
