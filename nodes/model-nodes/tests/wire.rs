//! The four nodes over real DDS on loopback, each in a participant of its own, with small random weights: what comes
//! out of the public topics, and that bad input is counted and survived. No ROS installation, and no sleep: every step
//! waits for the message that it causes.

use std::time::Duration;

use crate::running::model::write_model;
use crate::running::{PATIENCE, soon, with_nodes};
use image::{Rgb, RgbImage};
use wm_camera::image_message::{decode_compressed, decode_image, encode_image, encode_jpeg};
use wm_msgs::{
    builtin_interfaces::{Duration as RosDuration, Time},
    diagnostic_msgs::{DiagnosticArray, DiagnosticStatus},
    sensor_msgs::{CompressedImage, Image},
    std_msgs::{Header, String as Text},
    wm_msgs::{
        Action, ActionChunk, Latent, LatentSpace, Plan, Prediction, PredictionError, Reset,
        ResetRequest,
    },
};
use wm_ros::{Client, Context, Node, NodeArgs, Publisher, Qos, Subscription};
use wm_wire::latent_message::{LatentDtype, encode_latent};

/// The camera's period \[ns\].
const PERIOD: i64 = 200_000_000;
const START: i64 = 1_700_000_000_000_000_000;
const HORIZON: u32 = 3;
/// Side of the camera's image \[px\]; the autoencoder's is 32.
const SIDE: u32 = 48;

fn stamp(index: i64) -> Time {
    Time::from_nanos(START + index * PERIOD)
}

fn header(index: i64, frame_id: &str) -> Header {
    Header {
        stamp: stamp(index),
        frame_id: frame_id.into(),
    }
}

fn picture(index: i64) -> RgbImage {
    RgbImage::from_fn(SIDE, SIDE, |x, y| {
        // It goes round, and its colour changes: a picture that repeats is of a camera that has stopped.
        let ball = (i64::from(x) - (4 * index).rem_euclid(i64::from(SIDE))).abs() < 6
            && y.abs_diff(20) < 6;
        if ball {
            Rgb([220, 40, index.rem_euclid(200) as u8])
        } else {
            Rgb([90, (2 * x) as u8, (3 * y) as u8])
        }
    })
}

fn action(index: i64) -> Action {
    Action {
        header: header(index, "base_link"),
        values: vec![0.01, 0.0, 0.0, 0.0, 0.0, 0.02 * (index % 3) as f32, 1.0],
    }
}

/// The robot, the camera and the user: everything that the nodes hear, and everything that they say.
struct World {
    node: Node,
    camera: Publisher<Image>,
    /// A second camera on the same topic, with the same frame_id.
    other_camera: Publisher<Image>,
    actions: Publisher<Action>,
    chunks: Publisher<ActionChunk>,
    goals: Publisher<CompressedImage>,
    rogue: Publisher<Latent>,
    latents: Subscription<Latent>,
    predictions: Subscription<Prediction>,
    errors: Subscription<PredictionError>,
    pictures: Subscription<Image>,
    jpegs: Subscription<CompressedImage>,
    plans: Subscription<Plan>,
    diagnostics: Subscription<DiagnosticArray>,
    resets: [Client<Reset>; 2],
}

impl World {
    async fn new(context: &Context) -> Self {
        let args = NodeArgs::parse(Vec::<String>::new()).unwrap();
        let node = Node::new(context, "world", wm_ros::NAMESPACE, &args).unwrap();
        let many = Qos::best_effort(1000);
        let world = Self {
            camera: node
                .publisher("/camera/image_raw", Qos::sensor_data())
                .unwrap(),
            other_camera: node
                .publisher("/camera/image_raw", Qos::sensor_data())
                .unwrap(),
            actions: node.publisher("action", Qos::reliable(10)).unwrap(),
            chunks: node.publisher("action_chunk", Qos::reliable(10)).unwrap(),
            goals: node
                .publisher("goal/image/compressed", Qos::reliable(10))
                .unwrap(),
            rogue: node.publisher("latent", Qos::sensor_data()).unwrap(),
            latents: node.subscription("latent", many).unwrap(),
            predictions: node.subscription("predicted", many).unwrap(),
            errors: node.subscription("prediction_error", many).unwrap(),
            pictures: node.subscription("predicted/image", many).unwrap(),
            jpegs: node
                .subscription("predicted/image/compressed", many)
                .unwrap(),
            plans: node.subscription("plan", Qos::reliable(1000)).unwrap(),
            diagnostics: node.subscription("/diagnostics", many).unwrap(),
            // Made early: a server answers into the void until it has found the client's end, too.
            resets: ["predictor", "planner"]
                .map(|name| node.client(&format!("/wm/{name}/reset")).unwrap()),
            node,
        };
        let met = async {
            world.camera.wait_for_subscribers(1).await;
            world.other_camera.wait_for_subscribers(1).await;
            // Of encoder, predictor and planner.
            world.actions.wait_for_subscribers(3).await;
            world.chunks.wait_for_subscribers(2).await;
            world.goals.wait_for_subscribers(1).await;
            // This node itself, the predictor and the planner.
            world.rogue.wait_for_subscribers(3).await;
            world.latents.wait_for_publishers(2).await;
            world.predictions.wait_for_publishers(1).await;
            world.errors.wait_for_publishers(1).await;
            world.pictures.wait_for_publishers(1).await;
            world.jpegs.wait_for_publishers(1).await;
            world.plans.wait_for_publishers(1).await;
            for reset in &world.resets {
                reset.wait_for_service().await;
            }
        };
        tokio::time::timeout(PATIENCE, met)
            .await
            .expect("the nodes did not meet");
        world
    }

    /// One moment: the action taken and the camera's frame, up to the latent of it.
    async fn moment(&mut self, index: i64) -> Latent {
        self.actions.publish(&action(index)).unwrap();
        self.camera
            .publish(&encode_image(&picture(index), header(index, "camera")))
            .unwrap();
        loop {
            let latent = soon("the latent of a frame", &mut self.latents).await;
            if latent.header.stamp == stamp(index) {
                return latent;
            }
        }
    }

    /// The predictions from the frame of one moment.
    async fn predictions_from(&mut self, index: i64) -> Vec<Prediction> {
        let mut found = Vec::new();
        while found.len() < HORIZON as usize {
            let prediction = soon("a prediction", &mut self.predictions).await;
            if prediction.observed_stamp == stamp(index) {
                found.push(prediction);
            }
        }
        found
    }

    /// Moments until every node has been heard: the participants find one another at their own time. Ends with a
    /// moment whose rollout is decoded whole, so that the decoder is behind nothing: it leaves out what it is late for.
    async fn warm_up(&mut self) -> i64 {
        let mut has_plan = false;
        for index in 0..200 {
            self.moment(index).await;
            // No earlier rollout reaches as far.
            let last = stamp(index + 2 * i64::from(HORIZON));
            let decoded =
                async { while soon("a jpeg", &mut self.jpegs).await.header.stamp != last {} };
            let is_decoded = tokio::time::timeout(Duration::from_secs(2), decoded)
                .await
                .is_ok();
            has_plan |= self.plans.try_recv().is_some();
            if is_decoded && has_plan {
                return index + 1;
            }
        }
        panic!("no decoded rollout, or no plan ({has_plan})");
    }

    /// Waits until the diagnostics have an error of this name that says so.
    async fn condition(&mut self, name: &str, text: &str) {
        let is_it =
            |status: &DiagnosticStatus| status.name == name && status.message.contains(text);
        while !soon(name, &mut self.diagnostics)
            .await
            .status
            .iter()
            .any(is_it)
        {}
    }

    /// Waits until a node's diagnostics hold this.
    async fn diagnosed(&mut self, node: &str, key: &str, accept: impl Fn(&str) -> bool) {
        let find = async {
            loop {
                let Some(received) = self.diagnostics.recv().await else {
                    return;
                };
                let status = received
                    .message
                    .status
                    .into_iter()
                    .find(|status| status.name == node);
                let values = status.into_iter().flat_map(|status| status.values);
                if values
                    .into_iter()
                    .any(|pair| pair.key == key && accept(&pair.value))
                {
                    return;
                }
            }
        };
        tokio::time::timeout(PATIENCE, find)
            .await
            .unwrap_or_else(|_| panic!("{node} never said {key}"));
    }
}

#[test]
fn four_nodes_predict_plan_and_survive_bad_input() {
    let folder = tempfile::tempdir().unwrap();
    let space = write_model(folder.path());
    let model = format!("-p model:={}", folder.path().display());
    let nodes = [
        (
            &wm_model_nodes::encoder::NODE,
            format!("{model} -p dtype:=f32"),
        ),
        (
            &wm_model_nodes::predictor::NODE,
            format!("{model} -p horizon:={HORIZON} -p seed:=11"),
        ),
        (
            &wm_model_nodes::decoder::NODE,
            format!("{model} -p decode_period:=0.0"),
        ),
        (
            &wm_model_nodes::planner::NODE,
            format!(
                "{model} -p population:=12 -p iterations:=2 -p elites:=4 -p horizon:=2 -p plan_period:=0.4"
            ),
        ),
    ];
    with_nodes(&nodes, async |here| {
        let mut world = World::new(here).await;
        goal_before_any_frame(&mut world).await;
        let next = world.warm_up().await;
        let next = public_topics_carry_what_they_should(&mut world, &space, next).await;
        let next = bad_input_is_counted_and_survived(&mut world, &space, next).await;
        resets_and_jumps_flush(&mut world, next).await;
        another_aspect_begins_an_epoch(&mut world).await;
        late_joiner_gets_the_fit(&world).await;
    });
}

async fn goal_before_any_frame(world: &mut World) {
    let goal = encode_jpeg(&picture(30), header(30, "camera"), 95).unwrap();
    let waits = async {
        loop {
            // Once is not enough: the subscription is made in configure, and deaf until the node is active.
            world.goals.publish(&goal).unwrap();
            let status = soon("diagnostics", &mut world.diagnostics).await.status;
            if status.iter().any(|status| {
                status
                    .message
                    .contains("a goal is set, but no frame has arrived yet")
            }) {
                return;
            }
        }
    };
    tokio::time::timeout(PATIENCE, waits)
        .await
        .expect("the planner never said what it waits for");
}

async fn public_topics_carry_what_they_should(
    world: &mut World,
    space: &wm_model::LatentSpace,
    first: i64,
) -> i64 {
    // A chunk says what comes next; the predictor says that it was assumed.
    let coming: Vec<Action> = (first..first + 20)
        .map(|index| Action {
            values: vec![0.02; 7],
            ..action(index)
        })
        .collect();
    let chunk = ActionChunk {
        header: header(first, "base_link"),
        period: RosDuration::from_nanos(PERIOD),
        actions: coming,
        ..ActionChunk::default()
    };
    world.chunks.publish(&chunk).unwrap();
    for index in first..first + 3 {
        let latent = world.moment(index).await;
        let grid = [latent.height, latent.width, latent.channels].map(|side| side as usize);
        assert_eq!(
            (grid[0], grid[1], grid[2], latent.dtype),
            (space.height, space.width, space.channels, Latent::F32)
        );
        assert_eq!(
            (&latent.space.name, &latent.space.hash),
            (&space.name, &space.hash)
        );
        assert_eq!(latent.header.frame_id, "camera");

        for (k, prediction) in (1..).zip(world.predictions_from(index).await) {
            assert_eq!(
                (i64::from(prediction.step), prediction.horizon),
                (k, HORIZON)
            );
            assert_eq!(prediction.header, header(index + 2 * k, "camera"));
            assert_eq!((prediction.seed, prediction.integration_steps), (11, 1));
            assert_eq!(prediction.model_hash.len(), 64);
            assert!(
                prediction.received_stamp < prediction.ready_stamp
                    && prediction.received_stamp.sec > 0
            );
            assert_eq!(
                prediction.actions[0].values,
                action(index).values,
                "the action taken"
            );
            assert_eq!(prediction.actions[1].values, [0.02; 7], "the chunk's");

            let raw = soon("a predicted image", &mut world.pictures);
            let raw = skip_to(raw.await, prediction.header.stamp, &mut world.pictures).await;
            assert_eq!(
                (raw.width, raw.height, raw.encoding.as_str()),
                (32, 32, "rgb8")
            );
            let raw = decode_image(&raw).unwrap();
            let jpeg = loop {
                let jpeg = soon("a predicted jpeg", &mut world.jpegs).await;
                if jpeg.header.stamp == prediction.header.stamp {
                    break decode_compressed(&jpeg).unwrap();
                }
            };
            assert!(wm_metrics::images::psnr(&jpeg, &raw).unwrap() > 25.0);
        }
    }
    let error = loop {
        let error = soon("a prediction error", &mut world.errors).await;
        if error.header.stamp == stamp(first + 2) && error.step == 1 {
            break error;
        }
    };
    assert_eq!(error.observed_stamp, stamp(first));
    assert!(error.mse.is_finite() && error.persistence_mse > 0.0);
    assert!((error.ratio - error.mse / error.persistence_mse).abs() < 1e-3 * error.ratio);

    let plan = soon("a plan", &mut world.plans).await;
    assert_eq!(
        (plan.goal_stamp, plan.planner.as_str(), plan.actions.len()),
        (stamp(30), "icem", 2)
    );
    assert_eq!(plan.period, RosDuration::from_nanos(2 * PERIOD));
    assert!(plan.time_taken.to_nanos() > 0 && plan.cost.is_finite());
    assert_eq!(plan.searched, ["dx", "dy", "dz", "droll", "dpitch", "dyaw"]);
    assert!(plan.epoch > 0);
    // It begins where the search is expected to be over.
    let lead_ns = i64::from(plan.lead_steps) * 2 * PERIOD;
    let begins_ns = plan.actions[0].header.stamp.to_nanos();
    assert_eq!(begins_ns - plan.header.stamp.to_nanos(), lead_ns);
    first + 3
}

/// The picture of a stamp: earlier ones, of the warm-up, are passed over.
async fn skip_to(mut image: Image, stamp: Time, pictures: &mut Subscription<Image>) -> Image {
    while image.header.stamp != stamp {
        image = soon("a predicted image", pictures).await;
    }
    image
}

async fn bad_input_is_counted_and_survived(
    world: &mut World,
    space: &wm_model::LatentSpace,
    first: i64,
) -> i64 {
    let good = encode_image(&picture(first), header(first, "camera"));
    world.other_camera.publish(&good).unwrap();
    world
        .diagnosed("wm/encoder", "dropped: wrong_frame [total]", |total| {
            total == "1"
        })
        .await;
    world
        .camera
        .publish(&Image {
            encoding: "bayer_rggb16".into(),
            ..good.clone()
        })
        .unwrap();
    world
        .diagnosed("wm/encoder", "dropped: bad_image [total]", |total| {
            total == "1"
        })
        .await;
    // The same stamp again, malformed: by this transport it is a duplicate.
    world.camera.publish(&Image { step: 3, ..good }).unwrap();
    world
        .diagnosed("wm/encoder", "dropped: duplicate [total]", |total| {
            total == "1"
        })
        .await;

    let values = vec![0.5; space.elements()];
    let latent = encode_latent(
        &values,
        space,
        LatentDtype::F16,
        header(first + 1, "camera"),
    )
    .unwrap();
    let foreign = LatentSpace {
        name: "other".into(),
        hash: "00".into(),
    };
    world
        .rogue
        .publish(&Latent {
            space: foreign,
            ..latent.clone()
        })
        .unwrap();
    world
        .rogue
        .publish(&Latent {
            data: vec![0xff; latent.data.len()],
            ..latent
        })
        .unwrap();
    world
        .condition("wm/predictor: latent space", "parameter model")
        .await;
    let mut nan = action(first + 1);
    nan.values[3] = f32::NAN;
    world.actions.publish(&nan).unwrap();
    for node in ["wm/predictor", "wm/planner"] {
        for reason in ["wrong_space", "malformed_latent", "malformed_action"] {
            world
                .diagnosed(node, &format!("dropped: {reason} [total]"), |total| {
                    total == "1"
                })
                .await;
        }
    }
    let broken = CompressedImage {
        header: header(31, "camera"),
        format: "jpeg".into(),
        data: vec![0xff, 0xd8],
    };
    world.goals.publish(&broken).unwrap();
    world
        .diagnosed("wm/planner", "dropped: bad_goal [total]", |total| {
            total == "1"
        })
        .await;

    // The frame of `first` never came: a gap, and then all goes on.
    for index in first + 1..first + 5 {
        world.moment(index).await;
    }
    world
        .diagnosed("wm/predictor", "dropped: gap [total]", |total| total == "1")
        .await;
    assert_eq!(
        world.predictions_from(first + 4).await.len(),
        HORIZON as usize
    );
    first + 5
}

async fn resets_and_jumps_flush(world: &mut World, next: i64) {
    world.moment(next).await;
    let epoch = world.predictions_from(next).await[0].epoch;
    let next = next + 1;
    for client in &world.resets {
        let call = client.call(&ResetRequest {
            seed: 5,
            keep_seed: false,
        });
        let response = tokio::time::timeout(PATIENCE, call)
            .await
            .expect("no answer to a reset")
            .unwrap();
        assert!(
            response.success && response.message.contains("seed 5"),
            "{response:?}"
        );
    }
    for index in next..next + 3 {
        world.moment(index).await;
    }
    let predictions = world.predictions_from(next + 2).await;
    assert!(predictions.iter().all(|prediction| prediction.seed == 5));
    let after_reset = predictions[0].epoch;
    assert!(after_reset > epoch, "{after_reset} {epoch}");

    // The bag begins anew: the first prediction is from its third frame.
    for index in -40..-37 {
        world.moment(index).await;
    }
    let first = soon("a prediction after the jump", &mut world.predictions).await;
    assert_eq!(first.observed_stamp, stamp(-38));
    assert!(first.epoch > after_reset);
}

/// After the jump, which ends with the frame of -38.
async fn another_aspect_begins_an_epoch(world: &mut World) {
    let before = world.moment(-37).await.epoch;
    let wide = image::imageops::crop_imm(&picture(-36), 0, 0, SIDE, 32).to_image();
    let image = encode_image(&wide, header(-36, "camera"));
    world.camera.publish(&image).unwrap();
    let latent = loop {
        let latent = soon("the latent of a wide frame", &mut world.latents).await;
        if latent.header.stamp == stamp(-36) {
            break latent;
        }
    };
    assert!(latent.epoch > before, "{} {before}", latent.epoch);
    let is_named = |value: &str| value.starts_with("48x32, fit stretch");
    world
        .diagnosed("wm/encoder", "camera picture", is_named)
        .await;
}

async fn late_joiner_gets_the_fit(world: &World) {
    let mut fits = world
        .node
        .subscription_catching_up::<Text>("predicted/fit", Qos::reliable(1))
        .unwrap();
    assert_eq!(soon("the fit", &mut fits).await.data, "stretch");
}
