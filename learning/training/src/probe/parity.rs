//! Training steps of the success probes and their words against PyTorch.

use serde::Deserialize;

use super::{
    episodes::Question,
    loss::{cross_entropy, pointing_loss},
    things::Target,
    *,
};
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

/// A sample of one question.
fn sample(number: usize, asked: &Asked) -> Sample {
    Sample {
        latents: tensor(&format!("latents {number}"), &asked.shape, 1.5),
        episode: number,
        first_frame: 0,
        frames: asked.shape[1],
        frame_skip: 1,
        shift: [0; 2],
        questions: vec![Question {
            instruction: asked.instruction.clone(),
            answer: asked.answer,
            is_mismatch: false,
            weight: 1.0,
        }],
    }
}

#[test]
fn a_step_is_pytorchs() {
    let fixture = Fixture::open("probe");
    let fresh = FreshWeights::new(1);
    let loader = fresh.loader();
    let config = ProbeNetworkConfig::Transformer(fixture.of("config"));
    let model = ProbeNetwork::load(&config, &loader).unwrap();
    let words = Text::words(&fixture.of("words"), &loader).unwrap();
    let variables = fresh.into_variables().0;
    fill(&variables);
    let asked: Vec<Asked> = fixture.of("questions");
    let losses = asked.iter().enumerate().map(|(number, asked)| {
        let readings = [words.read(&asked.instruction).unwrap().unwrap()];
        let sample = sample(number, asked);
        loss(&model, &sample, &readings, None, &mut Dropout::none()).unwrap()
    });
    let losses: Vec<Tensor> = losses.collect();
    let loss = Tensor::stack(&losses, 0).unwrap().mean_all().unwrap();
    fixture.check(loss, &variables);
}

#[test]
fn a_step_of_the_grounded_one_is_pytorchs() {
    let fixture = Fixture::open("probe--grounded");
    let fresh = FreshWeights::new(1);
    let loader = fresh.loader();
    let config: ProbeNetworkConfig = fixture.of("config");
    let ProbeNetwork::Grounded(model) = ProbeNetwork::load(&config, &loader).unwrap() else {
        panic!("another kind");
    };
    let words = Text::words(&fixture.of("words"), &loader).unwrap();
    let variables = fresh.into_variables().0;
    fill(&variables);
    let asked: Vec<Asked> = fixture.of("questions");
    // All instructions are asked of the first episode.
    let questions: Vec<Question> = asked
        .iter()
        .enumerate()
        .flat_map(|(number, asked)| sample(number, asked).questions)
        .collect();
    let seen = model.look(&sample(0, &asked[0]).latents).unwrap();
    let read = asked.iter().map(|asked| {
        let reading = words.read(&asked.instruction).unwrap().unwrap();
        model.read(&reading.features, None).unwrap()
    });
    let read: Vec<_> = read.collect();
    let answers = model.answer(&seen, &read, &mut Dropout::none()).unwrap();
    let targets: Vec<(usize, usize, usize, usize, f64)> = fixture.of("targets");
    let targets = targets
        .into_iter()
        .map(|(question, frame, query, place, share)| {
            (
                question,
                Target {
                    frame,
                    query,
                    place,
                    share,
                },
            )
        });
    let targets: Vec<(usize, Target)> = targets.collect();
    let pointing = pointing_loss(&answers.attention, &targets)
        .unwrap()
        .unwrap();
    let loss = cross_entropy(&answers.logits, &questions).unwrap();
    fixture.check((loss + (pointing * 0.3).unwrap()).unwrap(), &variables);
}
