//! The nodes that move bags: player and recorder, `decode -> pure step -> encode` over `wm_ros` and `wm_bag`.

pub mod ending;
pub mod keyboard;
pub mod player;
pub mod qos_overrides;
pub mod recorder;
