//! The nodes: encoder, predictor, decoder and planner, each `decode -> pure step -> encode` over `wm_ros`; and what
//! surrounds them: launcher, player, recorder, monitor.
//!
//! A node's `step` module holds its whole behaviour and knows neither DDS nor a clock: it is tested with messages alone.
//! Its `node` module holds the wires: parameters, topics, QoS, threads, diagnostics. All public topics and their QoS
//! are in the repository's README.
//!
//! Not here: the models (`wm_model`), the ROS runtime (`wm_ros`), bags (`wm_bag`).

mod calls;
pub mod chunk_merging;
pub mod complaints;
pub mod decoder;
pub mod encoder;
pub mod ending;
pub mod env;
pub mod evaluator;
pub mod image_message;
pub mod keyboard;
pub mod latent_message;
pub mod launch;
pub mod model_choice;
pub mod monitor;
pub mod planner;
pub mod player;
pub mod pool;
pub mod predictor;
pub mod qos_overrides;
pub mod recorder;
pub mod report;
pub mod timeline;
pub mod transport;
pub mod work;

/// The namespace of all nodes, unless `__ns` says otherwise.
pub const NAMESPACE: &str = "/wm";
