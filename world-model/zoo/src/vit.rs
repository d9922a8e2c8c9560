//! Vision transformers: the frozen semantic encoders of the paper, and the parts that they share.
//!
//! | Encoder | Module | Feature of a 256x256 image |
//! |---|---|---|
//! | V-JEPA 2.1 ViT-L/16 | [`vjepa`] | 16x16x1024 |
//! | Web-DINO ViT-L/14 | [`web_dino`] | 16x16x1024 |
//! | SigLIP 2 so400m/14, vision | [`siglip`] | 16x16x1152 |
//! | SigLIP 2 so400m, text | [`siglip_text`] | 64 tokens of 1152 |
//!
//! Each takes the picture as a camera gives it and does its own [`preprocess`]ing. They are for
//! inference: there is no dropout, no masking of patches and no gradient.

mod block;
mod mlp;
mod patch_embedding;
pub(crate) mod preprocess;
pub(crate) mod resample;
mod rotary;
mod self_attention;
pub(crate) mod siglip;
pub(crate) mod siglip_text;
pub(crate) mod vjepa;
pub(crate) mod web_dino;

pub(crate) use block::{Block, BlockNames};
pub(crate) use mlp::Mlp;
pub(crate) use patch_embedding::PatchEmbedding;
pub(crate) use rotary::Rotary;
pub(crate) use self_attention::{Projections, SelfAttention, join_heads, split_heads};
pub(crate) use siglip::{SiglipVision, SiglipVisionConfig};
pub(crate) use siglip_text::{SiglipText, SiglipTextConfig};
pub(crate) use vjepa::{Vjepa, VjepaConfig};
pub use web_dino::{WebDino, WebDinoConfig};
