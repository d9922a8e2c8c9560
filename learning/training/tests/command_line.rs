//! The program itself: a whole model from simulated bags, interrupted and taken up again.

#![allow(clippy::unwrap_used, clippy::expect_used)] // the helpers of tests too, not only what is marked #[test]

use std::{
    io::{BufRead as _, BufReader},
    path::Path,
    process::{Command, Output, Stdio},
};

use wm_zoo::ModelFolder;

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

/// What a training tells that is sent a signal once it has taken steps of a part.
fn stopped(command: &mut Command, signal: &str, part: &str) -> String {
    // On a busy machine the signal may come before the first step, and nothing is trained. The next try goes on from there.
    let mut tries = (0..20).map(|_| stopped_at_once(command, signal, part));
    let told = tries.find(|told| !told.contains("after step 0 of"));
    told.expect("a step is taken before the signal comes")
}

/// The same, but the signal may come before the first step.
fn stopped_at_once(command: &mut Command, signal: &str, part: &str) -> String {
    let mut training = command.stdout(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(training.stdout.take().unwrap()).lines();
    let announced = format!("{part}:");
    let mut has_asked = false;
    let mut told = String::new();
    for line in lines {
        let line = line.unwrap();
        // It is said before the first step, in which the signal mostly comes.
        if !has_asked && line.starts_with(&announced) {
            let pid = training.id().to_string();
            let asked = Command::new("kill").args(["-s", signal, &pid]).status();
            assert!(asked.unwrap().success());
            has_asked = true;
        }
        told += &line;
        told.push('\n');
    }
    assert_eq!(training.wait().unwrap().code(), Some(130), "{told}");
    assert!(told.contains("the same command resumes"), "{told}");
    told
}

/// `wm train model` of every part with small networks and few steps.
fn train_model(data: &Path, cache: &Path, out: &Path) -> Command {
    let mut command = wm_training();
    command.args(["train", "model", "--threads", "2"]);
    for (flag, path) in [("--data", data), ("--cache", cache), ("--out", out)] {
        command.arg(flag).arg(path);
    }
    for setting in [
        "autoencoder.length=20 steps",
        "autoencoder.batch=2",
        "autoencoder.whole_picture_share=0.34",
        "autoencoder.model.name=small",
        "autoencoder.model.widths=[8, 8, 16, 16]",
        "autoencoder.model.encoder_blocks=[0, 0, 0, 1]",
        "autoencoder.model.decoder_blocks=[0, 0, 0, 1]",
        "transition.length=12 steps",
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

    // Stopped by a signal in its first part and in its second, and started again until it is through.
    let parts = at("parts");
    let model = || ModelFolder::open(parts.to_str().unwrap()).unwrap();
    let told = stopped(
        &mut train_model(&data, &cache, &parts),
        "INT",
        "autoencoder",
    );
    assert!(told.contains("no transition model yet"), "{told}");
    assert!(told.contains("transition   not begun"), "{told}");
    let [autoencoder] = &model().unfinished().unwrap()[..] else {
        panic!("{told}");
    };
    assert_eq!((&*autoencoder.part, autoencoder.steps), ("autoencoder", 20));
    assert!(
        told.contains(&format!("autoencoder  {autoencoder}")),
        "{told}"
    );
    model().decoder().unwrap();
    assert!(model().require_transition().is_err());

    let told = stopped(
        &mut train_model(&data, &cache, &parts),
        "TERM",
        "transition",
    );
    assert!(told.contains("autoencoder  done"), "{told}");
    assert!(told.contains("idm          not begun"), "{told}");
    assert!(
        told.contains(&format!("wm model info {}", parts.display())),
        "{told}"
    );
    let [transition] = &model().unfinished().unwrap()[..] else {
        panic!("{told}");
    };
    assert_eq!((&*transition.part, transition.steps), ("transition", 12));
    // It is no less a model.
    model().world_model().unwrap();

    let told = done(&mut train_model(&data, &cache, &parts));
    assert!(model().unfinished().unwrap().is_empty(), "{told}");
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
    // So are the data: once, by name, and with what is expected.
    let train = || {
        let mut train = wm_training();
        train.args(["train", "model"]);
        train.arg("--data").arg(&data).arg("--out").arg(&out);
        let output = train.output().unwrap();
        assert_eq!(output.status.code(), Some(1));
        assert!(output.stdout.is_empty(), "a part has begun");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let error = train();
    assert_eq!(error.matches("no such file").count(), 1, "{error}");
    assert!(error.contains(data.to_str().unwrap()), "{error}");
    assert!(error.contains("wm dataset BAGS --out FOLDER"), "{error}");
    std::fs::create_dir(&data).unwrap();
    let error = train();
    assert!(error.contains("found no recording"), "{error}");
    // And what a later part would replace.
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("idm.safetensors"), "theirs").unwrap();
    std::fs::create_dir(data.join("bag")).unwrap();
    std::fs::write(data.join("bag/metadata.yaml"), "").unwrap();
    let error = train();
    assert!(error.contains("idm.safetensors is there"), "{error}");
}

/// What `wm` has of it in its completions and man pages.
#[test]
fn the_program_tells_its_command_line() {
    let program = Path::new(env!("CARGO_BIN_EXE_wm-training"));
    let told = wm_program::command_line::query(program).unwrap();
    told.clone().debug_assert();
    let model = ["train", "model"]
        .iter()
        .try_fold(&told, |command, word| command.find_subcommand(word));
    let flags = model.unwrap().get_arguments();
    let flags: Vec<&str> = flags.filter_map(clap::Arg::get_long).collect();
    for flag in ["data", "out", "share", "validation"] {
        assert!(flags.contains(&flag), "{flag}: {flags:?}");
    }
    let eval = told.find_subcommand("eval").unwrap();
    assert!(eval.find_subcommand("imagined").is_some());
}
