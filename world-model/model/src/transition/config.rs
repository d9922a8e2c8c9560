//! What defines a transition model.

use candle_core::{DType, Tensor};
use serde::{Deserialize, Serialize};

use crate::ops::{HEAD_DIM_MULTIPLE, RopeLayout, RotaryTable};
use crate::sampler::settings::Sampler;
use crate::{Error, Result};

use super::{Parametrisation, parameters};

/// Which action is fed with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActionAlignment {
    /// The action that leads from this frame to the next, as in the published checkpoints. Every frame
    /// carries one, the new one too: the action after it, or, where that is not known, the last one, which goes on.
    WithFrame,
    /// The action that led to this frame. The first frame of a window gets zeros.
    WithResult,
}

/// Patches of a frame at most. A reference attends with a number for each pair of them, and a configuration must not
/// decide how much memory that is.
const MOST_TOKENS: usize = 1 << 12;

fn one_view() -> usize {
    1
}

/// Sizes and conventions of a transition model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TransitionConfig {
    /// Width of a token, d.
    pub hidden: usize,
    /// Blocks, each of a spatial and a temporal sub-block.
    pub depth: usize,
    /// Attention heads.
    pub heads: usize,
    /// Side of a patch, p, in latent places.
    pub patch: usize,
    /// Rows of a latent.
    pub latent_height: usize,
    /// Columns of a latent.
    pub latent_width: usize,
    /// Camera views side by side along the width; with several, positions have three axes.
    #[serde(default = "one_view")]
    pub views: usize,
    /// Positions of several views; without effect on one.
    #[serde(default)]
    pub rope_layout: RopeLayout,
    /// Channels of a latent, C.
    pub channels: usize,
    /// Values of an action, A.
    pub action_dim: usize,
    /// Frames that the model sees at most, the new one included.
    pub max_frames: usize,
    /// Width of the wide head, if the model has one (native high-dimensional latents).
    pub wide_head: Option<usize>,
    /// What the output stands for.
    pub parametrisation: Parametrisation,
    /// Which action is fed with a frame.
    pub action_alignment: ActionAlignment,
    /// Camera frames that one model step advances.
    pub frame_skip: usize,
    /// How to sample from it unless told otherwise.
    pub sampler: Sampler,
}

/// The time shift that `tiny` is trained at. One Euler step does not depend on it, more do.
const TINY_SHIFT: f64 = 16.0;

/// The time shift that the published checkpoints were trained and are sampled with (the paper, appendix B.2,
/// "Dimension-dependent noise schedule shift"): sqrt((256 / p^2) C / 4096). Latents for which that is below 1 (SD3's)
/// are not shifted.
pub fn published_shift(patch: usize, channels: usize) -> f64 {
    let ratio = 256.0 * channels as f64 / (patch * patch).max(1) as f64 / 4096.0;
    ratio.sqrt().max(1.0)
}

impl TransitionConfig {
    /// Batch and frames of consistent inputs.
    pub(super) fn check_input(
        &self,
        x: &Tensor,
        tau: &Tensor,
        action: &Tensor,
    ) -> Result<(usize, usize)> {
        let c = self;
        let &[b, t, h, w, channels] = x.dims() else {
            return Err(shape("the latents", "(B, T, H, W, C)", x));
        };
        if (h, w, channels) != (c.latent_height, c.latent_width, c.channels) {
            let expected = format!(
                "(B, T, {}, {}, {})",
                c.latent_height, c.latent_width, c.channels
            );
            return Err(shape("the latents", &expected, x));
        }
        if tau.dims() != [b, t] {
            return Err(shape("tau", &format!("({b}, {t})"), tau));
        }
        if action.dims() != [b, t, c.action_dim] {
            let expected = format!("({b}, {t}, {})", c.action_dim);
            return Err(shape("the actions", &expected, action));
        }
        for (what, tensor) in [("latents", x), ("tau", tau), ("actions", action)] {
            if tensor.dtype() != DType::F32 {
                return Err(Error::config(
                    "dtype",
                    format!("{what} are {:?}, expected F32", tensor.dtype()),
                ));
            }
        }
        Ok((b, t))
    }

    /// A preset by name: "dit-s", "dit-b", "dit-l" (384, 768, 1024 wide; 12, 12, 24 deep; plain
    /// head, conventions of the published checkpoints), or "tiny", the embedded default's.
    ///
    /// `latent` is (height, width, channels).
    ///
    /// # Errors
    /// If there is no such preset, or it does not fit the latent.
    pub fn preset(
        name: &str,
        latent: (usize, usize, usize),
        patch: usize,
        action_dim: usize,
    ) -> Result<Self> {
        let (hidden, depth, heads) = match name {
            "tiny" => (128, 5, 4),
            "dit-s" => (384, 12, 6),
            "dit-b" => (768, 12, 12),
            "dit-l" => (1024, 24, 16),
            _ => {
                return Err(Error::config(
                    "preset",
                    format!("`{name}`, expected tiny, dit-s, dit-b or dit-l"),
                ));
            }
        };
        let tiny = name == "tiny";
        let (latent_height, latent_width, channels) = latent;
        let config = Self {
            hidden,
            depth,
            heads,
            patch,
            latent_height,
            latent_width,
            views: 1,
            rope_layout: RopeLayout::default(),
            channels,
            action_dim,
            max_frames: 10,
            wide_head: None,
            parametrisation: if tiny {
                Parametrisation::Residual
            } else {
                Parametrisation::Velocity
            },
            action_alignment: if tiny {
                ActionAlignment::WithResult
            } else {
                ActionAlignment::WithFrame
            },
            frame_skip: 2,
            sampler: if tiny {
                Sampler {
                    steps: 1,
                    shift: TINY_SHIFT,
                    context_tau: 0.0,
                }
            } else {
                Sampler {
                    shift: published_shift(patch, channels),
                    ..Sampler::default()
                }
            },
        };
        config.validate()?;
        Ok(config)
    }

    /// Channels of an attention head.
    pub(crate) fn head_dim(&self) -> usize {
        self.hidden / self.heads.max(1)
    }

    /// Rows and columns of patches.
    pub fn grid(&self) -> (usize, usize) {
        let patch = self.patch.max(1);
        (self.latent_height / patch, self.latent_width / patch)
    }

    /// Angles of the tokens of a frame.
    pub(super) fn rotary(&self) -> RotaryTable {
        let ((rows, columns), dim) = (self.grid(), self.head_dim());
        match self.views {
            1 => RotaryTable::grid(rows, columns, dim),
            views => RotaryTable::views(rows, columns / views.max(1), views, self.rope_layout, dim),
        }
    }

    /// Tokens of a frame.
    pub fn tokens(&self) -> usize {
        self.grid().0 * self.grid().1
    }

    /// Hidden width of the feed-forward networks, h = floor(8 d / 3).
    pub(crate) fn ffn_hidden(&self) -> usize {
        2 * (4 * self.hidden) / 3
    }

    /// Values of a patch, p * p * C.
    pub(crate) fn patch_values(&self) -> usize {
        self.patch * self.patch * self.channels
    }

    /// Number of trained values.
    pub fn parameter_count(&self) -> usize {
        parameters::all(self)
            .iter()
            .map(|p| p.shape.iter().product::<usize>())
            .sum()
    }

    /// Checks that a model of this configuration can be built.
    ///
    /// # Errors
    /// [`Error::Config`] with the first field that is wrong.
    pub fn validate(&self) -> Result<()> {
        let positive = [
            ("hidden", self.hidden),
            ("depth", self.depth),
            ("heads", self.heads),
            ("patch", self.patch),
            ("latent_height", self.latent_height),
            ("latent_width", self.latent_width),
            ("views", self.views),
            ("channels", self.channels),
            ("action_dim", self.action_dim),
            ("frame_skip", self.frame_skip),
            ("wide_head", self.wide_head.unwrap_or(1)),
        ];
        for (field, value) in positive {
            // A bound, so that products of few sizes cannot overflow.
            if value == 0 || value > 1 << 16 {
                return Err(Error::config(
                    field,
                    format!("{value}, expected 1 to 65536"),
                ));
            }
        }
        if !(2..=1024).contains(&self.max_frames) {
            let reason = format!("{}, expected 2 to 1024", self.max_frames);
            return Err(Error::config("max_frames", reason));
        }
        let tokens =
            self.latent_height.div_ceil(self.patch) * self.latent_width.div_ceil(self.patch);
        if tokens > MOST_TOKENS {
            let reason = format!("{tokens} patches a frame, expected at most {MOST_TOKENS}");
            return Err(Error::config("latent_height", reason));
        }
        let values = (self.patch * self.patch).checked_mul(self.channels);
        if values.is_none_or(|values| values > 1 << 20) {
            let reason = format!(
                "{} x {} x {} values a patch",
                self.patch, self.patch, self.channels
            );
            return Err(Error::config(
                "channels",
                format!("{reason}, expected at most 2^20"),
            ));
        }
        if self.views > 1 && !self.latent_width.is_multiple_of(self.views * self.patch) {
            let reason = format!(
                "{}, expected a part of the {} columns that is a multiple of the patch, {}",
                self.views, self.latent_width, self.patch
            );
            return Err(Error::config("views", reason));
        }
        let head = self.heads * HEAD_DIM_MULTIPLE;
        if !self.hidden.is_multiple_of(head) {
            let reason = format!(
                "{} with {} heads, expected a multiple of {head}",
                self.hidden, self.heads
            );
            return Err(Error::config("hidden", reason));
        }
        for (field, size) in [
            ("latent_height", self.latent_height),
            ("latent_width", self.latent_width),
        ] {
            if !size.is_multiple_of(self.patch) {
                let reason = format!("{size}, expected a multiple of the patch {}", self.patch);
                return Err(Error::config(field, reason));
            }
        }
        self.sampler.validate()
    }
}

fn shape(what: &'static str, expected: &str, found: &Tensor) -> Error {
    Error::Shape {
        what,
        expected: expected.to_owned(),
        found: found.dims().to_vec(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(name: &str, latent: (usize, usize, usize), patch: usize, wide: bool) -> f64 {
        let mut config = TransitionConfig::preset(name, latent, patch, 10).unwrap();
        config.wide_head = wide.then_some(2048);
        let millions = config.parameter_count() as f64 / 1e6;
        (millions * 1e3).round() / 1e3
    }

    #[test]
    fn parameter_counts_are_the_published_ones() {
        let latents = [
            ((32, 32, 16), 2, false),
            ((16, 16, 16), 1, false),
            ((16, 16, 32), 1, false),
            ((16, 16, 96), 1, false),
            ((16, 16, 1024), 1, true),
            ((16, 16, 1152), 1, true),
        ];
        let published = [
            ("dit-s", [64.420, 64.383, 64.395, 64.445, 75.748, 76.059]),
            (
                "dit-b",
                [257.126, 257.053, 257.077, 257.176, 268.699, 269.060],
            ),
            (
                "dit-l",
                [910.082, 909.984, 910.016, 910.148, 921.490, 921.884],
            ),
        ];
        for (name, expected) in published {
            for ((latent, patch, wide), expected) in latents.into_iter().zip(expected) {
                assert_eq!(
                    count(name, latent, patch, wide),
                    expected,
                    "{name} {latent:?}"
                );
            }
        }
    }

    #[test]
    fn published_presets_sample_with_the_shift_of_their_latent() {
        for (latent, patch, expected) in [
            ((32, 32, 16), 2, 1.0),
            ((16, 16, 16), 1, 1.0),
            ((16, 16, 32), 1, 2f64.sqrt()),
            ((16, 16, 96), 1, 2.4495),
            ((16, 16, 1024), 1, 8.0),
            ((16, 16, 1152), 1, 8.4853),
        ] {
            let preset = TransitionConfig::preset("dit-s", latent, patch, 10).unwrap();
            assert!((preset.sampler.shift - expected).abs() < 1e-4, "{latent:?}");
        }
    }

    #[test]
    fn seven_actions_are_three_rows_fewer() {
        let ten = TransitionConfig::preset("dit-s", (16, 16, 16), 1, 10).unwrap();
        let seven = TransitionConfig::preset("dit-s", (16, 16, 16), 1, 7).unwrap();
        assert_eq!(
            ten.parameter_count() - seven.parameter_count(),
            3 * ten.hidden
        );
    }

    #[test]
    fn what_cannot_be_built_is_named() {
        let good = TransitionConfig::preset("tiny", (16, 16, 8), 2, 7).unwrap();
        let broken = [
            (
                "hidden",
                TransitionConfig {
                    hidden: 100,
                    ..good.clone()
                },
            ),
            (
                "latent_width",
                TransitionConfig {
                    latent_width: 15,
                    ..good.clone()
                },
            ),
            (
                "max_frames",
                TransitionConfig {
                    max_frames: 1,
                    ..good.clone()
                },
            ),
            (
                "depth",
                TransitionConfig {
                    depth: 0,
                    ..good.clone()
                },
            ),
        ];
        for (field, config) in broken {
            let message = config.validate().unwrap_err().to_string();
            assert!(message.starts_with(field), "{message}");
        }
        assert!(TransitionConfig::preset("dit-x", (16, 16, 8), 2, 7).is_err());
    }
}
