//! The program itself: a whole model from simulated bags, interrupted and taken up again.

#![allow(clippy::unwrap_used, clippy::expect_used)] // the helpers of tests too, not only what is marked #[test]

use std::{
    io::{BufRead as _, BufReader},
    path::Path,
    process::{Command, Output, Stdio},
};

fn wm_training() -> Command {
    Command::new(env!("CARGO_BIN_EXE_wm-training"))
}

fn done(command: &mut Command) -> String {
    let Output {
        status,
        stdout,
        stderr,
    } = command.output().unwrap();
    let (stdout, stderr) = (
        String::from_utf8_lossy(&stdout).into_owned(),
        String::from_utf8_lossy(&stderr).into_owned(),
    );
    assert!(
        status.success(),
        "{command:?}: {status}\n{stdout}\n{stderr}"
    );
    stdout
}

/// `wm train model` of every part with small networks and few steps.
fn train_model(data: &Path, cache: &Path, out: &Path) -> Command {
    let mut command = wm_training();
    command.args(["train", "model", "--threads", "2"]);
    for (flag, path) in [("--data", data), ("--cache", cache), ("--out", out)] {
        command.arg(flag).arg(path);
    }
    for setting in [
        "autoencoder.length=6 steps",
        "autoencoder.batch=2",
        "autoencoder.whole_picture_share=0.34",
        "autoencoder.model.name=small",
        "autoencoder.model.widths=[8, 8, 16, 16]",
        "autoencoder.model.encoder_blocks=[0, 0, 0, 1]",
        "autoencoder.model.decoder_blocks=[0, 0, 0, 1]",
        "transition.length=4 steps",
        "transition.batch=2",
        "transition.model.hidden=32",
        "transition.model.depth=1",
        "transition.model.heads=2",
        "idm.length=4 steps",
        "idm.batch=2",
        "idm.micro_batch=1",
        "idm.model.hidden=32",
        "idm.model.width=8",
        "probe.length=4 steps",
        "probe.batch=2",
        "probe.micro_batch=1",
        "probe.model.hidden=32",
        "probe.model.depth=1",
    ] {
        command.args(["--set", setting]);
    }
    command
}

#[test]
fn a_model_is_trained_by_one_command_and_an_interrupted_one_gives_the_same_bytes() {
    let scratch = tempfile::tempdir().unwrap();
    let at = |name: &str| scratch.path().join(name);
    let (bags, data, cache) = (at("bags"), at("data"), at("cache"));
    // Long enough for a window of the transition's validation, and with failures for the probe.
    let sim = [
        "sim",
        "--episodes",
        "6",
        "--frames",
        "24",
        "--failures",
        "0.5",
        "--out",
    ];
    done(wm_training().args(sim).arg(&bags));
    done(
        wm_training()
            .arg("dataset")
            .arg(&bags)
            .arg("--out")
            .arg(&data),
    );
    let summary = done(wm_training().args(["dataset", "info"]).arg(&data));
    assert!(summary.contains("6 bags"), "{summary}");

    let whole = at("whole");
    let told = done(&mut train_model(&data, &cache, &whole));
    assert!(told.contains("model:="), "{told}");

    // Stopped by a signal when it has begun to step, and started again until it is through.
    let parts = at("parts");
    let mut first = train_model(&data, &cache, &parts)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(first.stdout.take().unwrap()).lines();
    let mut has_asked = false;
    let mut told = String::new();
    for line in lines {
        let line = line.unwrap();
        if !has_asked && line.starts_with("transition:") {
            let pid = first.id().to_string();
            let asked = Command::new("kill").args(["-TERM", &pid]).status();
            assert!(asked.unwrap().success());
            has_asked = true;
        }
        told += &line;
        told.push('\n');
    }
    let status = first.wait().unwrap();
    assert_eq!(status.code(), Some(130), "{told}");
    assert!(told.contains("the same command resumes"), "{told}");
    let told = done(&mut train_model(&data, &cache, &parts));
    assert!(told.contains("resumes after step"), "{told}");
    for file in [
        "autoencoder.safetensors",
        "transition.safetensors",
        "idm.safetensors",
        "probe.safetensors",
        "transition.checkpoint.safetensors",
    ] {
        let read = |folder: &Path| std::fs::read(folder.join(file)).unwrap();
        assert!(read(&whole) == read(&parts), "{file}");
    }

    // Every part is fine-tuned from its own.
    let model = whole.to_str().unwrap();
    let tuned = at("tuned");
    done(train_model(&data, &cache, &tuned).args(["--from", model]));
    for part in ["autoencoder", "transition", "idm", "probe"] {
        let checkpoint = tuned.join(format!("{part}.checkpoint.safetensors"));
        let checkpoint = std::fs::read(&checkpoint).unwrap();
        // Its header says what it began from.
        let header = String::from_utf8_lossy(&checkpoint[..checkpoint.len().min(1 << 16)]);
        assert!(header.contains(model), "{part} does not begin from {model}");
    }

    // What was trained is measured by its own commands.
    let weights = |name: &str| whole.join(name).to_str().unwrap().to_owned();
    for (part, file) in [
        ("transition", "transition.safetensors"),
        ("idm", "idm.safetensors"),
        ("probe", "probe.safetensors"),
    ] {
        let mut eval = wm_training();
        eval.args([
            "eval",
            part,
            "--encoder",
            model,
            "--weights",
            &weights(file),
        ]);
        if part == "transition" {
            eval.args(["--plans", "1"]);
        }
        let told = done(eval.arg("--cache").arg(&cache).arg("--data").arg(&bags));
        assert!(!told.is_empty(), "{part}");
    }
}

/// A training of a model on a semantic encoder: its name, where the model that it builds on is, and its settings.
type Stage = (
    &'static str,
    &'static [&'static str],
    &'static [&'static str],
);

const STAGES: [Stage; 4] = [
    (
        "encoder",
        &[],
        &[
            "batch=2",
            "micro_batch=1",
            "model.patch=16",
            "model.hidden=16",
            "model.depth=1",
            "head.hidden=16",
            "head.width=8",
        ],
    ),
    (
        "adapter",
        &["--encoder", "encoder"],
        &[
            "batch=2",
            "micro_batch=1",
            "model.latent=4",
            "model.layers=1",
            "model.ffn=16",
            "model.base=8",
            "model.multipliers=[1, 1, 1, 1, 1]",
            "loss.kl_warm_up=0.0",
        ],
    ),
    (
        "transition",
        &["--encoder", "adapter"],
        &[
            "batch=2",
            "model.hidden=32",
            "model.depth=1",
            "model.heads=2",
            "model.frames=5",
        ],
    ),
    (
        "distill",
        &["--teacher", "adapter", "--accept"],
        &[
            "batch=2",
            "self_forcing.after=3 steps",
            "self_forcing.frames=3",
        ],
    ),
];

/// Each with a few steps, in one go and in two: the encoder, the adapter that compresses its features, the transition model
/// of what it gives, which belongs into the adapter's folder, and a student of that.
#[test]
fn every_training_of_a_semantic_model_is_taken_up_again_to_the_same_bytes() {
    let scratch = tempfile::tempdir().unwrap();
    let at = |name: &str| scratch.path().join(name);
    let (bags, cache) = (at("bags"), at("cache"));
    let sim = ["sim", "--episodes", "2", "--frames", "24", "--out"];
    done(wm_training().args(sim).arg(&bags));
    for (name, on, settings) in STAGES {
        let train = |way: &str, steps: u64| {
            let folder = |of: &str| scratch.path().join(way).join(of);
            let mut command = wm_training();
            command.args(["train", name, "--threads", "2", "--validation", "0"]);
            command.args(["--steps", &steps.to_string()]);
            // With a learning rate that does not depend on the length, it makes no difference where a run paused.
            command.args(["--set", "optimisation.final_rate=1.0"]);
            command.args(["--set", "optimisation.warm_up=0 steps"]);
            for setting in settings {
                command.args(["--set", setting]);
            }
            for word in on {
                match word.strip_prefix("--") {
                    Some(_) => command.arg(word),
                    None => command.arg(folder(word)),
                };
            }
            let out = match name {
                "transition" => "adapter",
                other => other,
            };
            command.arg("--data").arg(&bags).arg("--cache").arg(&cache);
            done(command.arg("--out").arg(folder(out)));
            folder(out)
        };
        let whole = train("whole", 4);
        train("parts", 2);
        let parts = train("parts", 4);
        let file = match name {
            "distill" => "transition",
            other => other,
        };
        for file in [
            format!("{file}.safetensors"),
            format!("{name}.checkpoint.safetensors"),
        ] {
            let read = |folder: &Path| std::fs::read(folder.join(&file)).unwrap();
            assert!(read(&whole) == read(&parts), "{name}: {file}");
        }
    }
}

#[test]
fn a_wrong_setting_is_named_before_anything_is_read() {
    let mut train = wm_training();
    train.args([
        "train",
        "model",
        "--data",
        "/no/such/bags",
        "--out",
        "/no/such/out",
    ]);
    let output = train.args(["--set", "decoder.batch=1"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(
        told.contains("decoder.batch=1") && told.contains("autoencoder, transition"),
        "{told}"
    );
}

/// Those of the last part too: hours lie between.
#[test]
fn what_a_later_part_cannot_take_is_named_before_the_first_begins() {
    let scratch = tempfile::tempdir().unwrap();
    let (data, out) = (scratch.path().join("data"), scratch.path().join("out"));
    for (wrong, told) in [
        (
            ["--set", "probe.optimisation.learing_rate=1"],
            "optimisation.learing_rate",
        ),
        (["--recipe", "huge"], "recipe huge: expected tiny or paper"),
        (["--from", "nowhere"], "nowhere: no such folder"),
        (["--encoder", "nowhere"], "nowhere: no such folder"),
    ] {
        let mut train = wm_training();
        train.args(["train", "model"]).args(wrong);
        train.arg("--data").arg(&data).arg("--out").arg(&out);
        let output = train.output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{wrong:?}");
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(error.contains(told), "{wrong:?}: {error}");
        assert!(output.stdout.is_empty(), "{wrong:?}: a part has begun");
        assert!(!out.exists(), "{wrong:?}");
    }
    // What is wrong with the data is said once.
    let mut train = wm_training();
    train.args(["train", "model"]);
    train.arg("--data").arg(&data).arg("--out").arg(&out);
    let output = train.output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(error.matches("No such file").count(), 1, "{error}");
}
