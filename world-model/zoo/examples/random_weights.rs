//! Makes a folder with a `model.json` into a model with random weights, to try the nodes, the transport and the speed of
//! a model before there are trained ones. Configurations of published encoders and the latent's statistics are filled in
//! too; a tokenizer is not. Files that are there are kept.
//!
//! `cargo run --release -p wm_zoo --example random_weights -- DIR [SEED]`

use std::path::Path;

use wm_zoo::folder::write_random_weights;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let folder = words.next().ok_or("expected a folder with a model.json")?;
    let seed = words
        .next()
        .map_or(Ok(0), |word| word.parse())
        .map_err(|error| format!("SEED: {error}"))?;
    for file in write_random_weights(Path::new(&folder), seed)? {
        println!("{}", file.display());
    }
    Ok(())
}
