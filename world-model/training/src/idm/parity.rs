//! A training step of the inverse dynamics model against PyTorch.

use super::*;
use crate::{
    fixture::{Fixture, fill, tensor},
    fresh_weights::FreshWeights,
};

#[test]
fn a_step_is_pytorchs() {
    for name in ["idm", "idm--patched"] {
        let fixture = Fixture::open(name);
        let config: IdmConfig = fixture.of("config");
        let fresh = FreshWeights::new(1);
        let model = Idm::load(&config, &fresh.loader()).unwrap();
        let variables = fresh.into_variables().0;
        fill(&variables);
        let (b, frames, [rows, columns]) = (2, config.horizon + 1, config.grid);
        let side = config.patch;
        let shape = [b, frames, rows * side, columns * side, config.features];
        let latents = tensor("latents", &shape, 1.5);
        let actions = tensor("actions", &[b, frames, config.actions], 2.0);
        let loss = loss(&model, (&latents, &actions), &mut Dropout::none()).unwrap();
        fixture.check(loss, &variables);
    }
}
