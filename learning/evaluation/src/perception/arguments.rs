use std::path::PathBuf;

use clap::Args;

/// Networks of the user.
#[derive(Clone, Debug, Default, Args)]
pub struct PerceptionArgs {
    /// networks.yaml with the ONNX files for FID, FVD, image quality, flow and others, for the suite fidelity
    /// (docs/evaluation.md). Needs a build with the feature onnx
    #[arg(long, value_name = "FILE")]
    pub networks: Option<PathBuf>,
    /// Folder with alexnet and heads (.safetensors, .pth or .pt), for LPIPS from torch's files instead of an ONNX file
    #[arg(long, value_name = "DIR")]
    pub lpips: Option<PathBuf>,
}

impl PerceptionArgs {
    /// Whether no network is given.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.networks.is_none() && self.lpips.is_none()
    }
}
