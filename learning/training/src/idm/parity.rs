//! A training step of the inverse dynamics model against PyTorch.

use super::*;
use crate::{
    fixture::{Fixture, fill, tensor},
    fresh_weights::FreshWeights,
};

#[test]
fn step_matches_pytorch() {
    for name in ["idm", "idm--patched", "idm--convolutional"] {
        let fixture = Fixture::open(name);
        let config: IdmNetworkConfig = fixture.of("config");
        let fresh = FreshWeights::new(1);
        let model = IdmNetwork::load(&config, &fresh.loader()).unwrap();
        let variables = fresh.into_variables().0;
        fill(&variables);
        let (grid, side, features, actions) = match &config {
            IdmNetworkConfig::Transformer(c) => (c.grid, c.patch, c.features, c.actions),
            IdmNetworkConfig::Convolutional(c) => (c.grid, 1, c.features, c.actions),
        };
        let (b, frames, [rows, columns]) = (2, config.horizon() + 1, grid);
        let shape = [b, frames, rows * side, columns * side, features];
        let latents = tensor("latents", &shape, 1.5);
        let actions = tensor("actions", &[b, frames, actions], 2.0);
        let loss = loss(&model, (&latents, &actions), &mut Dropout::none()).unwrap();
        fixture.check(loss, &variables);
    }
}
