//! Motion of a clip from the outputs of networks: optical flow, point tracks, features and distances of its frames (the
//! paper, appendix C.2 B, after VBench and WorldArena).

mod consistency;
mod dynamics;
mod flow;
mod photometric;
mod temporal_lpips;
mod tracks;
mod warp;

pub use consistency::feature_consistency;
pub use dynamics::{
    DYNAMIC_THRESHOLD_PX, dynamic_degree, flow_score, mean_flow, soft_dynamic_degree,
};
pub use flow::{Flow, TOP_SHARE};
pub use photometric::{PHOTOMETRIC_CROP_PX, forward_backward_error, photometric_consistency};
pub use temporal_lpips::temporal_lpips;
pub use tracks::{PointCoverage, point_coverage};
pub use warp::warp;
