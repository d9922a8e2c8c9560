//! Training steps of the success probes and their word embeddings against PyTorch.

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
struct FixtureQuestion {
    instruction: String,
    answer: bool,
    shape: Vec<usize>,
}

/// A sample of one question.
fn sample(number: usize, question: &FixtureQuestion) -> Sample {
    Sample {
        latents: tensor(&format!("latents {number}"), &question.shape, 1.5),
        episode: number,
        first_frame: 0,
        frames: question.shape[1],
        frame_skip: 1,
        shift: [0; 2],
        questions: vec![Question {
            instruction: question.instruction.clone(),
            answer: question.answer,
            is_mismatch: false,
            weight: 1.0,
        }],
    }
}

#[test]
fn step_matches_pytorch() {
    let fixture = Fixture::open("probe");
    let fresh = FreshWeights::new(1);
    let loader = fresh.loader();
    let config = ProbeNetworkConfig::Transformer(fixture.of("config"));
    let model = ProbeNetwork::load(&config, &loader).unwrap();
    let words = Text::words(&fixture.of("words"), &loader).unwrap();
    let variables = fresh.into_variables().0;
    fill(&variables);
    let question: Vec<FixtureQuestion> = fixture.of("questions");
    let losses = question.iter().enumerate().map(|(number, question)| {
        let readings = [words.read(&question.instruction).unwrap().unwrap()];
        let sample = sample(number, question);
        loss(&model, &sample, &readings, None, &mut Dropout::none()).unwrap()
    });
    let losses: Vec<Tensor> = losses.collect();
    let loss = Tensor::stack(&losses, 0).unwrap().mean_all().unwrap();
    fixture.check(loss, &variables);
}

#[test]
fn step_of_the_grounded_probe_matches_pytorch() {
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
    let question: Vec<FixtureQuestion> = fixture.of("questions");
    // All instructions are questions on the first episode.
    let questions: Vec<Question> = question
        .iter()
        .enumerate()
        .flat_map(|(number, question)| sample(number, question).questions)
        .collect();
    let seen = model.look(&sample(0, &question[0]).latents).unwrap();
    let read = question.iter().map(|question| {
        let reading = words.read(&question.instruction).unwrap().unwrap();
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
