//! The nodes that play and record bags: player and recorder, `decode -> pure step -> encode` over `wm_ros` and
//! `wm_bag`.

pub mod ending;
pub mod keyboard;
pub mod player;
pub mod qos_overrides;
pub mod recorder;

use wm_ros::NodeDefinition;

/// All of them.
pub const NODES: &[NodeDefinition<anyhow::Error>] = &[player::NODE, recorder::NODE];
