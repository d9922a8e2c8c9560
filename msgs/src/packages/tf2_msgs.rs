//! Package `tf2_msgs`: where frames are.

use super::geometry_msgs::TransformStamped;
use serde::{Deserialize, Serialize};

/// Where frames are in others, on `/tf` and `/tf_static`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TFMessage {
    /// One a frame.
    pub transforms: Vec<TransformStamped>,
}

message!(
    TFMessage,
    "tf2_msgs",
    "geometry_msgs/TransformStamped[] transforms\n",
    [TransformStamped]
);
