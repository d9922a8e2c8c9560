#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use std::time::Instant;

use serde_json::json;
use tempfile::TempDir;
use wm_model::WorldModel;
use wm_msgs::{
    builtin_interfaces::{Duration, Time},
    std_msgs::Header,
    wm_msgs::{Action, ActionCandidates, ActionChunk, CandidateAssessment},
};
use wm_zoo::{ModelFolder, folder::write_random_weights, success_probe::SuccessClassifier};

use super::*;
use crate::{
    evaluator::{EvaluationRequest, EvaluatorModel, EvaluatorSettings, EvaluatorStep},
    history::{ChunkMerging, History, HistorySettings, Reception, Timing},
};
use wm_ros::PublisherId;
use wm_wire::latent_message::{LatentDtype, encode_latent};

const PERIOD: i64 = 200_000_000;

/// A model of latents of 4x4x8 with random weights and a probe, in a folder.
fn probed_model() -> (TempDir, WorldModel, Arc<SuccessClassifier>) {
    let description = json!({
        "name": "probed",
        "image": [32, 32],
        "encoder": {"kind": "web-dino", "weights": "encoder.safetensors", "config": {
            "hidden_size": 8, "num_hidden_layers": 1, "num_attention_heads": 2, "image_size": 28, "patch_size": 7}},
        "normalisation": {"mean": vec![0.1; 8], "std": vec![2.0; 8]},
        "transition": {"weights": "dit.safetensors", "actions": {"frame_skip": 2}, "sampler": {"steps": 2, "shift": 1.5, "context_tau": 0.01},
            "config": {"hidden": 32, "depth": 1, "heads": 2, "channels": 8, "patch": 1, "grid": [4, 4], "action_dim": 7}},
        "probe": {"weights": "probe.safetensors",
            "config": {"features": 8, "max_frames": 8, "text_features": 16, "pool": 2, "hidden": 16, "depth": 2,
                       "heads": 2, "ffn": 20},
            "text": {"weights": "text.safetensors", "tokenizer": "tokenizer.json", "config": {
                "vocab_size": 6, "hidden_size": 16, "intermediate_size": 24, "num_hidden_layers": 1,
                "num_attention_heads": 2, "max_position_embeddings": 8}}}
    });
    let tokenizer = json!({
        "version": "1.0", "truncation": null, "padding": null, "added_tokens": [], "normalizer": null,
        "pre_tokenizer": {"type": "Whitespace"}, "post_processor": null, "decoder": null,
        "model": {"type": "WordLevel", "unk_token": "?",
                  "vocab": {"<pad>": 0, "?": 1, "open": 2, "the": 3, "drawer": 4, "close": 5}}
    });
    let folder = tempfile::tempdir().unwrap();
    let write = |name, content: serde_json::Value| {
        std::fs::write(folder.path().join(name), content.to_string()).unwrap();
    };
    write("model.json", description);
    write("tokenizer.json", tokenizer);
    write_random_weights(folder.path(), 5).unwrap();
    let model = ModelFolder::open(&folder.path().to_string_lossy()).unwrap();
    let probe = model.probe().unwrap().unwrap();
    let predictor = model.world_model().unwrap();
    (folder, predictor, Arc::new(probe))
}

fn header(index: i64) -> Header {
    Header {
        stamp: Time::from_nanos(index * PERIOD),
        frame_id: "camera".into(),
    }
}

fn action(index: i64, value: f32) -> Action {
    Action {
        header: header(index),
        values: vec![value, 0.0, -value, 0.0, 0.0, 0.0, 1.0],
    }
}

/// Chunks of two model steps behind frame 2, each with one value.
fn candidates(values: &[f32]) -> ActionCandidates {
    let chunk = |value: &f32| ActionChunk {
        header: header(2),
        period: Duration::from_nanos(PERIOD),
        actions: (2..6).map(|index| action(index, *value)).collect(),
        ..ActionChunk::default()
    };
    ActionCandidates {
        header: header(2),
        policy: "test".into(),
        chunks: values.iter().map(chunk).collect(),
    }
}

/// An evaluator that has seen frames 0 to 2 and the actions between.
fn evaluator(model: &WorldModel) -> EvaluatorStep {
    let settings = EvaluatorSettings {
        max_age: std::time::Duration::from_secs(60),
        horizon: 5,
        max_candidates: 8,
        seed: 9,
    };
    let history = HistorySettings {
        timing: Timing::new(PERIOD, 2),
        context_frames: 2,
        merging: ChunkMerging::Latest,
    };
    let (space, encoding) = (model.space.clone(), model.encoding.clone());
    let history = History::new(history, space, encoding, Time::default());
    let mut step = EvaluatorStep::new(settings, history);
    let reception = Reception {
        stamp: Time::default(),
        clock_step_ns: 0,
        at: Instant::now(),
        publisher: PublisherId::default(),
    };
    for index in 0..3 {
        step.action(&action(index, 0.01), Time::default()).unwrap();
        let values: Vec<f32> = (0..128)
            .map(|i| ((i + 7 * index) as f32 * 0.3).sin())
            .collect();
        let latent = encode_latent(&values, &model.space, LatentDtype::F32, header(index)).unwrap();
        step.latent(&latent, reception).unwrap();
    }
    step
}

fn text(words: &str) -> Text {
    Text { data: words.into() }
}

/// Sends the instruction `words`, as the node does.
fn instruct(step: &mut EvaluatorStep, probe: &SuccessClassifier, words: &str) {
    let words = step.task_mut().take(&text(words)).unwrap();
    let read = probe.instruction(&words);
    step.task_mut().read(words, read);
}

/// Sends candidates, as the node does.
fn ask(step: &EvaluatorStep, asked: &ActionCandidates) -> EvaluationRequest {
    let request = step.candidates(asked, Instant::now(), Time::default());
    request.unwrap()
}

fn probabilities(candidates: &[CandidateAssessment]) -> Vec<f32> {
    candidates.iter().map(|c| c.success_probability).collect()
}

#[test]
fn each_candidate_has_its_own_success_probability() {
    let (_folder, predictor, probe) = probed_model();
    let mut step = evaluator(&predictor);
    instruct(&mut step, &probe, "open the drawer");
    let model = EvaluatorModel::new(predictor.clone(), 0).with_probe(Some(Arc::clone(&probe)));
    let of = |step: &EvaluatorStep, values: &[f32]| {
        let request = ask(step, &candidates(values));
        probabilities(&model.evaluate(&request).unwrap().assessment.candidates)
    };
    let close = |a: &[f32], b: &[f32]| {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-6)
    };
    let opening = of(&step, &[0.04, 0.0, -0.04]);
    assert!(opening.iter().all(|p| *p > 0.0 && *p < 1.0), "{opening:?}");
    let apart = |a: usize, b: usize| (opening[a] - opening[b]).abs() > 2e-5;
    assert!(apart(0, 1) && apart(1, 2) && apart(0, 2), "{opening:?}");

    // Neither the others nor their order are any part of it.
    let turned = of(&step, &[-0.04, 0.0, 0.04]);
    let back: Vec<f32> = turned.iter().rev().copied().collect();
    assert!(close(&back, &opening), "{back:?} {opening:?}");
    assert!(close(&of(&step, &[0.0]), &opening[1..2]));

    // It is that of the observed frames with the predicted ones behind.
    let request = ask(&step, &candidates(&[0.04, 0.0, -0.04]));
    let latents = model.evaluate(&request).unwrap().latents;
    let instruction = probe.instruction("open the drawer").unwrap();
    for (index, found) in opening.iter().enumerate() {
        let mut frames = request.moment.context();
        frames.extend(latents.iter().map(|of_step| of_step[index].as_slice()));
        let episode = predictor.space.stack(&frames).unwrap();
        assert_eq!(episode.dim(0).unwrap(), 4);
        let expected = probe.probability(&episode, &instruction).unwrap();
        assert!((found - expected).abs() < 1e-6, "{found} {expected}");
    }

    instruct(&mut step, &probe, "close the drawer");
    let closing = of(&step, &[0.04, 0.0, -0.04]);
    assert!(!close(&closing, &opening), "{closing:?} {opening:?}");
}

#[test]
fn without_probe_or_instruction_there_is_no_probability() {
    let (_folder, predictor, probe) = probed_model();
    let mut step = evaluator(&predictor);
    let without = EvaluatorModel::new(predictor.clone(), 0);
    let with = without.clone().with_probe(Some(Arc::clone(&probe)));
    let asked = candidates(&[0.04, -0.04]);
    let found = |model: &EvaluatorModel, step: &EvaluatorStep| {
        let request = ask(step, &asked);
        model.evaluate(&request).unwrap().assessment.candidates
    };
    assert!(
        probabilities(&found(&with, &step))
            .iter()
            .all(|p| p.is_nan())
    );
    instruct(&mut step, &probe, "open the drawer");
    let unprobed = found(&without, &step);
    assert!(probabilities(&unprobed).iter().all(|p| p.is_nan()));
    let probed = found(&with, &step);
    assert!(probabilities(&probed).iter().all(|p| p.is_finite()));
    assert_eq!(probed[1].latent, unprobed[1].latent);
    // An instruction that is taken back.
    assert_eq!(step.task_mut().take(&text(" ")), None);
    assert!(
        probabilities(&found(&with, &step))
            .iter()
            .all(|p| p.is_nan())
    );
}

#[test]
fn an_instruction_is_read_once_and_the_newest_counts() {
    let (_folder, _predictor, probe) = probed_model();
    let mut task = Task::default();
    assert_eq!(task.to_string(), "NaN: no instruction yet");
    let first = task.take(&text("open the drawer\n")).unwrap();
    assert_eq!(first, "open the drawer");
    assert_eq!(
        task.to_string(),
        "NaN: the instruction \"open the drawer\" is still being encoded"
    );
    assert_eq!(
        task.take(&text("open the drawer")),
        None,
        "it is being read"
    );

    // Another one before the first has been read: what the first gives comes too late.
    let second = task.take(&text("close the drawer")).unwrap();
    let read = probe.instruction(&first);
    task.read(first, read);
    assert!(task.instruction().is_none());
    let read = probe.instruction(&second);
    task.read(second, read);
    assert_eq!(task.instruction().unwrap().text(), "close the drawer");
    assert_eq!(task.to_string(), "of \"close the drawer\"");
    assert_eq!(task.take(&text("close the drawer")), None, "it is known");

    let long = task.take(&text(&"open ".repeat(1000))).unwrap();
    let read = probe.instruction(&long);
    task.read(long, read);
    assert!(task.instruction().is_none());
    let said = task.to_string();
    assert!(
        said.contains("cannot be encoded: instruction: 4999 bytes"),
        "{said}"
    );
    assert!(said.len() < 250, "{said}");
    assert_eq!(task.take(&text("")), None);
    assert_eq!(task.to_string(), "NaN: no instruction yet");
}
