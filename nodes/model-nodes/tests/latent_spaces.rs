//! Latents of every shape, live: native semantic ones of 16x16x1024 (512 KiB in f16) between two participants, and model
//! folders with and without adapter run by the nodes on the bundled bag, over real DDS on loopback. The folders' weights
//! are random and their networks one layer deep; all the rest is real.

use std::{path::Path, time::Duration};

use crate::fresh_domain::fresh_domain;
use crate::running::{PATIENCE, context, quiet, soon, with_nodes};
use serde_json::{Value, json};
use wm_camera::image_message::decode_compressed;
use wm_model::{LatentSpace, trained_folder::TrainedFolder};
use wm_model_nodes::{decoder, encoder, planner, predictor};
use wm_msgs::{
    builtin_interfaces::Time,
    diagnostic_msgs::DiagnosticArray,
    sensor_msgs::CompressedImage,
    std_msgs::Header,
    wm_msgs::{Latent, Plan, Prediction},
};
use wm_robot_nodes::player;
use wm_ros::{Node, NodeArgs, NodeDefinition, Qos, Subscription};
use wm_wire::latent_message::{LATENT_QOS, LatentDtype, decode_latent, encode_latent};
use wm_zoo::{ModelFolder, folder};

const HORIZON: u32 = 2;

/// Ten seconds at 5 Hz.
const LATENTS: i64 = 50;
const PERIOD: Duration = Duration::from_millis(200);

/// Web-DINO's native latents of 16x16x1024; its pixel decoder takes them through the adapter.
fn native() -> Value {
    json!({
        "name": "native",
        "encoder": {"kind": "web-dino", "weights": "encoder.safetensors", "config": {
            "hidden_size": 1024, "num_hidden_layers": 1, "num_attention_heads": 16, "mlp_ratio": 1}},
        "decoder": {"kind": "pixel", "weights": "svae.safetensors",
            "config": {"latent": 96, "base": 32, "multipliers": [1, 1, 1, 1], "res_blocks": 1, "heads": 1},
            "adapter": svae()},
        "transition": {"weights": "dit.safetensors", "config": {
            "hidden": 64, "depth": 1, "heads": 2, "channels": 1024, "patch": 1, "grid": [16, 16], "action_dim": 10,
            "head": "wide", "wide_dim": 64},
            "sampler": {"steps": 1, "shift": 1.0, "context_tau": 0.01}}
    })
}

/// The same through the adapter, 16x16x96, normalised.
fn adapted() -> Value {
    let mut model = native();
    model["name"] = json!("adapted");
    model["adapter"] = svae();
    model["normalisation"] = json!({"mean": vec![0.1; 96], "std": vec![1.5; 96]});
    model["decoder"]["adapter"] = Value::Null;
    model["transition"]["config"]["channels"] = json!(96);
    model["transition"]["config"]["head"] = json!("plain");
    model
}

fn svae() -> Value {
    json!({"kind": "svae", "weights": "svae.safetensors",
        "config": {"features": 1024, "latent": 96, "heads": 16, "layers": 1, "ffn": 64}})
}

fn write(folder: &Path, model: &Value) -> LatentSpace {
    std::fs::write(folder.join(folder::FILE), model.to_string()).unwrap();
    folder::write_random_weights(folder, 1).unwrap();
    ModelFolder::open(&folder.to_string_lossy())
        .unwrap()
        .space()
        .unwrap()
}

/// What the nodes say.
struct Listener {
    _node: Node,
    latents: Subscription<Latent>,
    predictions: Subscription<Prediction>,
    jpegs: Subscription<CompressedImage>,
    plans: Subscription<Plan>,
    diagnostics: Subscription<DiagnosticArray>,
}

impl Listener {
    fn new(context: &wm_ros::Context) -> Self {
        let args = NodeArgs::parse(Vec::<String>::new()).unwrap();
        let node = Node::new(context, "listener", wm_ros::NAMESPACE, &args).unwrap();
        let many = Qos::best_effort(100);
        Self {
            latents: node.subscription("latent", many).unwrap(),
            predictions: node.subscription("predicted", many).unwrap(),
            jpegs: node
                .subscription("predicted/image/compressed", many)
                .unwrap(),
            plans: node.subscription("plan", Qos::reliable(100)).unwrap(),
            diagnostics: node.subscription("/diagnostics", many).unwrap(),
            _node: node,
        }
    }

    /// Waits until the status of `node` says this.
    async fn diagnosed(&mut self, node: &str, accept: impl Fn(&str) -> bool) {
        let find = async {
            loop {
                let array = soon("diagnostics", &mut self.diagnostics).await;
                let mut of_node = array.status.iter().filter(|status| status.name == node);
                if of_node.any(|status| accept(&status.message)) {
                    return;
                }
            }
        };
        tokio::time::timeout(PATIENCE, find)
            .await
            .unwrap_or_else(|_| panic!("{node} never said it"));
    }
}

/// The nodes of `model`, another planner with the embedded model, and the bundled bag at a quarter of its rate.
fn nodes(model: &Path) -> [(&'static NodeDefinition<anyhow::Error>, String); 6] {
    let model = format!("-p model:={}", model.display());
    let bag = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../bags/tabletop");
    let cem = "-p population:=4 -p iterations:=1 -p elites:=2";
    [
        (&encoder::NODE, model.clone()),
        (&predictor::NODE, format!("{model} -p horizon:={HORIZON}")),
        (&decoder::NODE, format!("{model} -p decode_period:=0.0")),
        (&planner::NODE, format!("{model} {cem}")),
        (&planner::NODE, format!("{cem} -r __node:=stranger")),
        (
            &player::NODE,
            format!(
                "-p bag:={} -p rate:=0.25 -p loop:=true -p goal:=true -p \
             wait_for:=[/wm/latent,/wm/predicted,/wm/plan] -p wait_timeout:=30.0",
                bag.display()
            ),
        ),
    ]
}

fn check_nodes(model: &Value, channels: u32) {
    let folder = tempfile::tempdir().unwrap();
    let space = write(folder.path(), model);
    assert_eq!(space.shape(), (16, 16, channels as usize));
    let has_decoder = !model["decoder"].is_null();
    with_nodes(&nodes(folder.path()), async |here| {
        let mut listener = Listener::new(here);
        let latent = soon("a latent", &mut listener.latents).await;
        assert_eq!(latent.data.len(), 16 * 16 * channels as usize * 2);
        decode_latent(&latent, &space).expect("the encoder's latent is of the folder's space");

        let prediction = soon("a prediction", &mut listener.predictions).await;
        let of = &prediction.latent;
        assert_eq!((of.height, of.width, of.channels), (16, 16, channels));
        assert_eq!(prediction.horizon, HORIZON);
        let values = decode_latent(of, &space).expect("the prediction is of the same space");
        assert!(values.iter().any(|value| *value != 0.0));

        if has_decoder {
            let jpeg = soon("a predicted picture", &mut listener.jpegs).await;
            let picture = decode_compressed(&jpeg).unwrap();
            assert_eq!(picture.dimensions(), (128, 128));
        } else {
            let idle = |message: &str| message.contains("idle") && message.contains("no decoder");
            listener.diagnosed("wm/decoder", idle).await;
        }
        let plan = soon("a plan", &mut listener.plans).await;
        assert!(plan.cost.is_finite());

        // A planner of another model counts every latent that it refuses, and names both spaces.
        let is_refused = |message: &str| message.contains("wrong_space");
        listener.diagnosed("wm/stranger", is_refused).await;
        let tiny = TrainedFolder::Embedded
            .autoencoder()
            .unwrap()
            .space()
            .clone();
        let refusal = decode_latent(&latent, &tiny).unwrap_err().to_string();
        assert!(
            refusal.contains(&space.name) && refusal.contains(&tiny.name),
            "{refusal}"
        );
    });
}

#[test]
fn native_semantic_latents_run_through_the_nodes() {
    check_nodes(&native(), 1024);
}

#[test]
fn adapted_latents_run_through_the_nodes() {
    check_nodes(&adapted(), 96);
}

#[test]
fn a_model_without_decoder_leaves_the_decoder_idle() {
    let mut model = adapted();
    model["decoder"] = Value::Null;
    check_nodes(&model, 96);
}

fn native_space() -> LatentSpace {
    LatentSpace {
        name: "native".into(),
        hash: "00".repeat(32),
        height: 16,
        width: 16,
        channels: 1024,
    }
}

/// Values that f16 holds; no two latents share one.
fn values(index: i64) -> Vec<f32> {
    let value = |at: usize| ((at as i64 + index) % 2039) as f32 / 512.0 - 2.0;
    (0..native_space().elements()).map(value).collect()
}

#[test]
fn no_latent_is_lost_at_5_hz_in_10_s() {
    let _quiet = quiet();
    let domain = fresh_domain();
    let (here, there) = (context(domain), context(domain));
    let args = NodeArgs::parse(Vec::<String>::new()).unwrap();
    let node = |context, name| Node::new(context, name, wm_ros::NAMESPACE, &args).unwrap();
    let (sender, receiver) = (node(&here, "sender"), node(&there, "receiver"));
    let publisher = sender.publisher::<Latent>("latent", LATENT_QOS).unwrap();
    let mut subscription = receiver
        .subscription::<Latent>("latent", LATENT_QOS)
        .unwrap();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let met = async {
            publisher.wait_for_subscribers(1).await;
            subscription.wait_for_publishers(1).await;
        };
        tokio::time::timeout(PATIENCE, met)
            .await
            .expect("the nodes did not meet");
        let receiving = tokio::spawn(async move {
            for index in 0..LATENTS {
                let latent = soon("a latent", &mut subscription).await;
                assert_eq!(latent.header.stamp.to_nanos(), index, "a latent is missing");
                assert_eq!(
                    decode_latent(&latent, &native_space()).unwrap(),
                    values(index)
                );
            }
            (subscription.lost(), subscription.dropped())
        });
        // The period is the subject: it is what the writer's and the reader's queues have to hold out.
        let mut tick = tokio::time::interval(PERIOD);
        for index in 0..LATENTS {
            tick.tick().await;
            let header = Header {
                stamp: Time::from_nanos(index),
                frame_id: "camera".into(),
            };
            let latent =
                encode_latent(&values(index), &native_space(), LatentDtype::F16, header).unwrap();
            publisher.publish(&latent).unwrap();
        }
        assert_eq!(receiving.await.unwrap(), (0, 0));
        assert_eq!(publisher.dropped(), 0);
    });
    drop(publisher);
    for context in [here, there] {
        context.shutdown().trigger();
        context.close();
    }
}
