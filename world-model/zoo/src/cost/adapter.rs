//! The cost of the S-VAE adapter.

use super::{Cost, applied, attended, count};
use crate::Result;
use crate::svae::{Svae, SvaeConfig};

/// Tokens of a frame.
const TOKENS: usize = 16 * 16;

/// Counts an adapter: the parameters of both halves, the operations of the encoder, which is all that prediction
/// needs.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn adapter(config: &SvaeConfig) -> Result<Cost> {
    count(
        |loader| Svae::load(config, loader),
        |weight| {
            if !weight.name.starts_with("enc_") {
                return 0;
            }
            let attention = if weight.name.ends_with("query.weight") {
                attended(TOKENS, TOKENS, config.features)
            } else {
                0
            };
            applied(weight, TOKENS) + attention
        },
    )
}
