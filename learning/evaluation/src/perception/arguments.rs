use std::path::PathBuf;

use clap::Args;

/// Networks of the user's.
#[derive(Clone, Debug, Default, Args)]
pub struct PerceptionArgs {
    /// networks.yaml: the ONNX files that FID, FVD, image quality, flow and the like are measured with, for the suite fidelity
    /// (docs/evaluation.md). It takes a build with the feature onnx.
    #[arg(long, value_name = "FILE")]
    pub networks: Option<PathBuf>,
    /// Folder with alexnet and heads (.safetensors, .pth or .pt): LPIPS of torch's files instead of an ONNX file.
    #[arg(long, value_name = "DIR")]
    pub lpips: Option<PathBuf>,
}

impl PerceptionArgs {
    /// Whether none is named.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.networks.is_none() && self.lpips.is_none()
    }
}
