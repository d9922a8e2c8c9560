//! Whether the parts of a model folder fit together: each fault names both sides.

use super::{Description, Dynamics, Opened, Pictures};
use crate::svae::SvaeConfig;

/// Rows, columns and channels of the latent of all views.
pub(super) fn latent(
    [rows, columns, width]: [usize; 3],
    adapter: Option<&Opened<SvaeConfig>>,
    views: usize,
) -> Result<[usize; 3], String> {
    let channels = match adapter {
        None => width,
        Some(adapter) if adapter.config.features == width => adapter.config.latent,
        Some(adapter) => {
            return Err(format!(
                "the adapter takes features of {} channels, the encoder gives {width}",
                adapter.config.features
            ));
        }
    };
    Ok([rows, columns * views, channels])
}

pub(super) fn check_transition(
    description: &Description,
    latent: [usize; 3],
    transition: &Dynamics,
) -> Result<(), String> {
    let config = &transition.config;
    let taken = [config.latent_height, config.latent_width, config.channels];
    if taken == latent {
        return Ok(());
    }
    Err(format!(
        "the transition takes latents of {}, {} gives {}",
        sides(taken),
        giver(description, config.views),
        sides(latent)
    ))
}

pub(super) fn check_decoder(
    description: &Description,
    [_, _, channels]: [usize; 3],
    Pictures { decoder, adapter }: &Pictures,
) -> Result<(), String> {
    let mut given = (giver(description, 1), channels);
    if let Some(adapter) = adapter {
        if adapter.config.features != channels {
            return Err(format!(
                "the decoder's adapter takes latents of {} channels, {} gives {channels}",
                adapter.config.features, given.0
            ));
        }
        given = ("the decoder's adapter".to_owned(), adapter.config.latent);
    }
    let taken = decoder.config.channels();
    if taken == given.1 {
        return Ok(());
    }
    Err(format!(
        "the decoder {} takes latents of {taken} channels, {} gives {}",
        decoder.source.kind, given.0, given.1
    ))
}

/// What makes the latents, in words.
pub(super) fn giver(description: &Description, views: usize) -> String {
    let [height, width] = description.image;
    let through = match &description.adapter {
        Some(_) => "with the adapter",
        None => "without an adapter",
    };
    let of = match views {
        1 => String::new(),
        views => format!("{views} views of "),
    };
    format!(
        "the encoder {} {through} on {of}{height}x{width}",
        description.encoder.kind
    )
}

fn sides([height, width, channels]: [usize; 3]) -> String {
    format!("{height}x{width}x{channels}")
}
