use rand::SeedableRng as _;
use serde_json::json;
use wm_dataset::Dataset;
use wm_zoo::{
    ModelFolder,
    folder::write_random_weights,
    success_probe::{GroundedProbeConfig, SuccessClassifier},
};

use super::{arguments::train_on, episodes::Question, loss::cross_entropy, *};
use crate::{
    arguments::tests::run_in,
    recipe::{Span, tests::bundled},
    run::{Stop, tests::expect_same_bytes_after_pause},
    transition::tests::{labelled, moving},
};

fn small(name: &str, steps: u64) -> ProbeRecipe {
    let settings = [
        "batch=8",
        "micro_batch=4",
        "model.pool=2",
        "model.hidden=32",
        "model.depth=1",
        "model.width=8",
        "model.channels=8",
        "model.text_width=16",
        "model.frames=4",
        "others=2",
        "negatives=any",
        "model.heads=2",
        "model.ffn=48",
        "model.text_features=16",
        "model.frame_skip=1",
        "optimisation.ema_decay=0.9",
        "optimisation.learning_rate=3e-3",
        "validate_every=50",
    ];
    ProbeRecipe {
        length: Span::Steps(steps),
        ..bundled(name, &settings)
    }
}

/// Episodes that succeed if their level ends on the side in the instruction.
#[test]
fn training_learns_to_follow_instructions() {
    let dir = tempfile::tempdir().unwrap();
    let (train, held_out) = (labelled(dir.path(), 200, 1), labelled(dir.path(), 40, 2));
    let recipe = small("tiny", 400);
    let stop = Stop::default();
    let latents = (&train, Some(&held_out));
    train_on(&run_in(dir.path()), &recipe, latents, (None, None), &stop).unwrap();
    let weights = Weights::open(dir.path().join(FILE)).unwrap();
    let episodes = Episodes::new(&held_out, 1, None);
    let reader = Reader::of_trained(&weights).unwrap();
    let read = |text: &str| Ok(Some(reader.read(text)?));
    let found = accuracy(&weights, &episodes, usize::MAX, read).unwrap();
    println!("{found}");
    assert!(found.balanced() > 0.8, "{found}");
    assert!(found.mismatches.unwrap() > 0.8, "{found}");
    // The kept weights are the best of all validations.
    let kept: Accuracy = weights.json(VALIDATION_KEY).unwrap();
    assert!(
        (kept.balanced() - found.balanced()).abs() < 1e-9,
        "{kept} {found}"
    );
}

/// Episodes that succeed if their level ends above zero, whatever the instruction.
fn ended_high(dir: &Path, episodes: usize, seed: u64) -> Latents {
    let told = labelled(dir, episodes, seed);
    let mut list = told.episodes().to_vec();
    for episode in &mut list {
        let is_up = episode.instruction.as_deref() == Some("go up");
        episode.success = episode.success.map(|success| success == is_up);
    }
    let file = dir.join(format!("latents {seed}"));
    let actions = told.action_space().clone();
    Latents::map(&file, told.space().clone(), list, "high".into(), actions).unwrap()
}

#[test]
fn probes_without_instructions_learn_visible_outcomes() {
    let dir = tempfile::tempdir().unwrap();
    let (train, held_out) = (
        ended_high(dir.path(), 200, 1),
        ended_high(dir.path(), 100, 2),
    );
    for (kind, name, least) in [
        (ProbeKind::Linear, "linear", 0.75),
        (ProbeKind::Temporal, "temporal", 0.85),
    ] {
        let mut recipe = small("tiny", 300);
        recipe.model.kind = kind;
        let (run, stop) = (run_in(&dir.path().join(name)), Stop::default());
        let latents = (&train, Some(&held_out));
        train_on(&run, &recipe, latents, (None, None), &stop).unwrap();
        let weights = Weights::open(run.out.join(FILE)).unwrap();
        let kept: Accuracy = weights.json(VALIDATION_KEY).unwrap();
        println!("{name}: {kept}");
        assert!(kept.balanced() > least, "{name}: {kept}");
        assert_eq!(kept.mismatches, None);
        // Opened as by a model's folder or `wm eval latents --probe`.
        let probe = SuccessClassifier::of_trained(weights, train.space()).unwrap();
        assert_eq!((probe.kind(), probe.reads_instructions()), (name, false));
        assert_eq!(probe.vocabulary(), None);

        let tower = Some(dir.path());
        let refused = train_on(&run, &recipe, latents, (None, tower), &stop).unwrap_err();
        assert!(refused.to_string().contains("--text-tower"), "{refused}");
    }
}

#[test]
fn probe_without_instructions_needs_failures() {
    let dir = tempfile::tempdir().unwrap();
    let told = labelled(dir.path(), 8, 1);
    let mut list = told.episodes().to_vec();
    list.iter_mut().for_each(|e| e.success = Some(true));
    let actions = told.action_space().clone();
    let file = dir.path().join("latents 1");
    let all = Latents::map(&file, told.space().clone(), list, "all".into(), actions).unwrap();
    let mut recipe = small("tiny", 1);
    recipe.model.kind = ProbeKind::Linear;
    let (run, stop) = (run_in(dir.path()), Stop::default());
    let error = train_on(&run, &recipe, (&all, None), (None, None), &stop).unwrap_err();
    assert!(
        error.to_string().contains("none of the 8 episodes"),
        "{error}"
    );
}

#[test]
fn paused_training_gives_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let (train, held_out) = (labelled(dir.path(), 12, 1), labelled(dir.path(), 12, 2));
    for name in ["tiny", "paper"] {
        let train = |out: &Path, steps| {
            let mut recipe = small(name, steps);
            recipe.optimisation.final_rate = 1.0;
            recipe.validate_every = 2;
            let run = run_in(out);
            let latents = (&train, Some(&held_out));
            train_on(&run, &recipe, latents, (None, None), &Stop::default()).unwrap();
        };
        let files = [FILE, "probe.checkpoint.safetensors"];
        expect_same_bytes_after_pause(&dir.path().join(name), &files, [2, 4], train);
    }
}

#[test]
fn data_without_outcomes_are_rejected_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 2, 1);
    let run = run_in(dir.path());
    let (recipe, stop) = (small("tiny", 1), Stop::default());
    let error = train_on(&run, &recipe, (&latents, None), (None, None), &stop).unwrap_err();
    assert!(error.to_string().contains("/task/success"), "{error}");
}

#[test]
fn bundled_probe_judges_the_bundled_bag() {
    let bag = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../bags/tabletop");
    let dir = tempfile::tempdir().unwrap();
    let model = ModelFolder::open("tiny").unwrap();
    let encoder = model.encoder().unwrap();
    let cache = dir.path().join("cache");
    let dataset = Dataset::open(&bag, &cache, encoder.framing()).unwrap();
    let latents = Latents::open(&dataset, &*encoder, &cache).unwrap();
    let episodes = Episodes::new(&latents, 2, None);
    let episode = episodes.all(1).next().unwrap().unwrap();
    let shown = episode.latents.squeeze(0).unwrap();
    let probe = model.probe().unwrap().unwrap();
    let probability = |text: &str| {
        let instruction = probe.instruction(text).unwrap();
        probe.probability(&shown, &instruction).unwrap()
    };
    let own = probability(&episode.questions[0].instruction);
    let other = probability("put the purple box to the right of the white box");
    println!("{own} {other}");
    assert!(own > 0.5 && other < 0.5, "{own} {other}");
}

#[test]
fn fine_tuned_probe_uses_the_new_grid() {
    let dir = tempfile::tempdir().unwrap();
    let latents = labelled(dir.path(), 4, 1);
    let (rows, columns, features) = latents.space().shape();
    let old = GroundedProbeConfig {
        features: features + 1,
        grid: [rows + 3, columns + 5],
        max_frames: 7,
        text_features: 4,
        frames: 3,
        width: 4,
        channels: 4,
        queries: 2,
        text_width: 4,
        text_depth: 1,
        text_heads: 1,
        hidden: 4,
    };
    let new = super::recipe::resized(
        ProbeNetworkConfig::Grounded(old.clone()),
        latents.space(),
        9,
    );
    let expected = GroundedProbeConfig {
        features,
        grid: [rows, columns],
        max_frames: 9,
        ..old
    };
    assert_eq!(new, ProbeNetworkConfig::Grounded(expected));
}

#[test]
fn fine_tuned_probe_keeps_its_words() {
    let dir = tempfile::tempdir().unwrap();
    let (first, second) = (dir.path().join("first"), dir.path().join("second"));
    let data = labelled(dir.path(), 12, 1);
    let (mut recipe, stop) = (small("tiny", 1), Stop::default());
    let probe = |run: &RunArgs, recipe: &ProbeRecipe, data: &Latents| {
        train_on(run, recipe, (data, None), (None, None), &stop).unwrap();
        let weights = Weights::open(run.out.join(FILE)).unwrap();
        let words: WordsConfig = weights.json(WORDS_KEY).unwrap();
        let shape = [words.vocabulary.len(), words.features];
        let table = weights.values(WORD_FEATURES, &shape).unwrap();
        (words, table)
    };
    let (old, old_table) = probe(&run_in(&first), &recipe, &data);
    assert_eq!(old.vocabulary, ["down", "go", "up"]);

    let mut episodes = data.episodes().to_vec();
    for episode in &mut episodes {
        let is_up = episode.instruction.as_deref() == Some("go up");
        let instruction = if is_up { "always go up" } else { "never go up" };
        episode.instruction = Some(instruction.into());
    }
    let (file, space) = (dir.path().join("latents 1"), data.space().clone());
    let actions = data.action_space().clone();
    let data = Latents::map(&file, space, episodes, "other".into(), actions).unwrap();
    let run = RunArgs {
        from: Some(first.display().to_string()),
        ..run_in(&second)
    };
    recipe.optimisation.learning_rate = 0.0;
    let (new, table) = probe(&run, &recipe, &data);
    assert_eq!(new.vocabulary, ["down", "go", "up", "always", "never"]);
    assert_eq!((old.max_words, new.max_words), (2, 3));
    let (kept, added) = table.split_at(old_table.len());
    assert_eq!(kept, old_table);
    assert!(added.iter().all(|value| *value != 0.0), "{added:?}");
}

#[test]
fn latents_are_shifted_with_repeated_borders() {
    let rows = Tensor::new(&[[1.0f32, 2.0, 3.0], [4.0, 5.0, 6.0]], &Device::Cpu).unwrap();
    let found = |dim, by| shifted(&rows, dim, by).unwrap().to_vec2::<f32>().unwrap();
    assert_eq!(found(1, 1), [[1.0, 1.0, 2.0], [4.0, 4.0, 5.0]]);
    assert_eq!(found(0, -1), [[4.0, 5.0, 6.0], [4.0, 5.0, 6.0]]);
    assert_eq!(found(1, 0), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
}

#[test]
fn cross_entropy_matches_the_probability() {
    let logits = [-2.0f32, 0.5, 90.0];
    for answer in [true, false] {
        let questions = [1.0, 0.5, 0.25].map(|weight| Question {
            instruction: String::new(),
            answer,
            is_mismatch: false,
            weight,
        });
        let found = cross_entropy(&Tensor::new(&logits, &Device::Cpu).unwrap(), &questions);
        let found = f64::from(found.unwrap().to_scalar::<f32>().unwrap());
        let losses = logits.iter().zip(&questions).map(|(logit, question)| {
            let signed = f64::from(if answer { *logit } else { -*logit });
            question.weight * (1.0 + (-signed).exp()).ln()
        });
        let expected: f64 = losses.sum();
        assert!((found - expected).abs() < 1e-5 * expected.max(1.0));
    }
}

#[test]
fn questions_have_their_shares() {
    let dir = tempfile::tempdir().unwrap();
    let data = labelled(dir.path(), 60, 1);
    let episodes = Episodes::new(&data, 1, None);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for others in [1, 5] {
        let shares = Shares {
            successes: 0.4,
            mismatches: 0.5,
            others,
        };
        let (mut found, count) = ([0.0; 3], 3000);
        for _ in 0..count {
            let sample = episodes.draw(shares, &mut rng).unwrap();
            let sum: f64 = sample.questions.iter().map(|asked| asked.weight).sum();
            assert!((sum - 1.0).abs() < 1e-9, "{sum}");
            // With few instructions, another episode often has the same.
            for (number, asked) in sample.questions.iter().enumerate() {
                let kind = match (number, asked.answer) {
                    (0, true) => 0,
                    (0, false) => 1,
                    _ => 2,
                };
                found[kind] += asked.weight / f64::from(count);
            }
        }
        for (found, expected) in found.into_iter().zip([0.4, 0.3, 0.3]) {
            assert!((found - expected).abs() < 0.03, "{found} {expected}");
        }
    }
}

#[test]
fn negatives_are_of_another_family() {
    let dir = tempfile::tempdir().unwrap();
    let data = labelled(dir.path(), 60, 1);
    let one = Episodes::new(&data, 1, None).with(Negatives::OtherFamily);
    let error = one.require_negatives().unwrap_err().to_string();
    assert!(error.contains("negatives=any"), "{error}");

    let instructions = ["Go up", "go to the left", "lift the arm"];
    let mut episodes = data.episodes().to_vec();
    for (episode, instruction) in episodes.iter_mut().zip(instructions.into_iter().cycle()) {
        episode.instruction = Some(instruction.into());
    }
    let (file, space) = (dir.path().join("latents 1"), data.space().clone());
    let actions = data.action_space().clone();
    let data = Latents::map(&file, space, episodes, "families".into(), actions).unwrap();
    let episodes = Episodes::new(&data, 1, None).with(Negatives::OtherFamily);
    let shares = Shares {
        successes: 0.5,
        mismatches: 0.5,
        others: 3,
    };
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let drawn = (0..200).map(|_| episodes.draw(shares, &mut rng));
    for sample in drawn.chain(episodes.all(usize::MAX)) {
        let asked: Vec<bool> = (sample.unwrap().questions.iter())
            .map(|question| question.instruction.starts_with("lift"))
            .collect();
        assert!(
            asked[1..].iter().all(|other| *other != asked[0]),
            "{asked:?}"
        );
    }
}

/// A folder with a text tower of random weights, which still separates words.
fn text_tower(dir: &Path) -> PathBuf {
    let config = json!({"vocab_size": 8, "hidden_size": 16, "intermediate_size": 24, "num_hidden_layers": 1,
        "num_attention_heads": 2, "max_position_embeddings": 8});
    let description = json!({
        "name": "probed",
        "image": [32, 32],
        "encoder": {"kind": "web-dino", "weights": "encoder.safetensors", "config": {
            "hidden_size": 8, "num_hidden_layers": 1, "num_attention_heads": 2, "image_size": 28, "patch_size": 7}},
        "probe": {"weights": "probe.safetensors",
            "config": {"features": 8, "max_frames": 8, "text_features": 16, "pool": 2, "hidden": 16, "depth": 1,
                       "heads": 2, "ffn": 20},
            "text": {"weights": "model.safetensors", "tokenizer": "tokenizer.json", "config": "config.json"}}
    });
    let tokenizer = json!({
        "version": "1.0", "truncation": null, "padding": null, "added_tokens": [], "normalizer": null,
        "pre_tokenizer": {"type": "Whitespace"}, "post_processor": null, "decoder": null,
        "model": {"type": "WordLevel", "unk_token": "?",
                  "vocab": {"<pad>": 0, "?": 1, "go": 2, "up": 3, "down": 4, "to": 5, "left": 6, "right": 7}}
    });
    let folder = dir.join("siglip2");
    std::fs::create_dir(&folder).unwrap();
    for (name, content) in [
        ("config.json", config),
        ("model.json", description),
        ("tokenizer.json", tokenizer),
    ] {
        std::fs::write(folder.join(name), content.to_string()).unwrap();
    }
    write_random_weights(&folder, 5).unwrap();
    folder
}

#[test]
fn text_tower_reads_instructions() {
    let dir = tempfile::tempdir().unwrap();
    let (train, held_out) = (labelled(dir.path(), 200, 1), labelled(dir.path(), 40, 2));
    let tower = text_tower(dir.path());
    let (recipe, stop) = (small("tiny", 400), Stop::default());
    let (run, latents) = (run_in(dir.path()), (&train, Some(&held_out)));
    train_on(&run, &recipe, latents, (None, Some(&tower)), &stop).unwrap();
    let weights = Weights::open(dir.path().join(FILE)).unwrap();
    let kept: Accuracy = weights.json(VALIDATION_KEY).unwrap();
    println!("{kept}");
    assert!(kept.balanced() > 0.8, "{kept}");

    // As the nodes: the weights refer to the tower.
    let classifier = SuccessClassifier::of_trained(weights, held_out.space()).unwrap();
    let sample = Episodes::new(&held_out, 1, None)
        .all(1)
        .next()
        .unwrap()
        .unwrap();
    let instruction = classifier
        .instruction(&sample.questions[0].instruction)
        .unwrap();
    let episode = sample.latents.squeeze(0).unwrap();
    assert!(classifier.probability(&episode, &instruction).unwrap() > 0.0);
    std::fs::rename(&tower, dir.path().join("elsewhere")).unwrap();
    let weights = Weights::open(dir.path().join(FILE)).unwrap();
    let error = SuccessClassifier::of_trained(weights, held_out.space()).unwrap_err();
    assert!(error.to_string().contains("siglip2"), "{error}");
}
