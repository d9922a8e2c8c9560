//! A training step of the success probe and its words against PyTorch.

use serde::Deserialize;

use super::*;
use crate::{
    fixture::{Fixture, fill, tensor},
    fresh_weights::FreshWeights,
};

#[derive(Deserialize)]
struct Asked {
    instruction: String,
    answer: bool,
    shape: Vec<usize>,
}

#[test]
fn a_step_is_pytorchs() {
    let fixture = Fixture::open("probe");
    let fresh = FreshWeights::new(1);
    let loader = fresh.loader();
    let model = SuccessProbe::load(&fixture.of("config"), &loader).unwrap();
    let words = Text::words(&fixture.of("words"), &loader).unwrap();
    let variables = fresh.into_variables().0;
    fill(&variables);
    let asked: Vec<Asked> = fixture.of("questions");
    let losses = asked.into_iter().enumerate().map(|(number, asked)| {
        let question = Question {
            latents: tensor(&format!("latents {number}"), &asked.shape, 1.5),
            instruction: asked.instruction,
            answer: asked.answer,
            is_mismatch: false,
        };
        let reading = words.read(&question.instruction).unwrap();
        loss(&model, &reading, &question, &mut Dropout::none()).unwrap()
    });
    let losses: Vec<Tensor> = losses.collect();
    let loss = Tensor::cat(&losses, 0).unwrap().mean_all().unwrap();
    fixture.check(loss, &variables);
}
