//! The whole program: trains a model from simulated bags, with interruptions.

use std::{
    io::{BufRead as _, BufReader, Lines},
    path::Path,
    process::{Child, ChildStdout, Command, Output, Stdio},
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

/// Output of a training that receives a signal after steps of a part.
fn stopped(command: &mut Command, signal: &str, part: &str) -> String {
    // On a busy machine the signal may arrive before the first step; the next try continues.
    let mut tries = (0..20).map(|_| stopped_at_once(command, signal, part));
    let output = tries.find(|output| !output.contains("after step 0 of"));
    output.expect("a step is taken before the signal comes")
}

/// [`stopped`], but the signal may arrive before the first step.
fn stopped_at_once(command: &mut Command, signal: &str, part: &str) -> String {
    let mut training = command.stdout(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(training.stdout.take().unwrap()).lines();
    let announced = format!("{part}:");
    let mut has_asked = false;
    let mut output = String::new();
    for line in lines {
        let line = line.unwrap();
        // Printed before the first step, during which the signal usually arrives.
        if !has_asked && line.starts_with(&announced) {
            let pid = training.id().to_string();
            let asked = Command::new("kill").args(["-s", signal, &pid]).status();
            assert!(asked.unwrap().success());
            has_asked = true;
        }
        output += &line;
        output.push('\n');
    }
    assert_eq!(training.wait().unwrap().code(), Some(130), "{output}");
    assert!(output.contains("the same command resumes"), "{output}");
    output
}

/// `wm train model` with all parts, small networks and few steps.
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
fn interrupted_model_training_gives_the_same_bytes() {
    let scratch = tempfile::tempdir().unwrap();
    let at = |name: &str| scratch.path().join(name);
    let (bags, data, cache) = (at("bags"), at("data"), at("cache"));
    // Long enough for a window of the transition's validation, with failures for the probe.
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
    let listen = ["--listen", "127.0.0.1:0"];
    let output = done(train_model(&data, &cache, &whole).args(listen));
    assert!(output.contains("model:="), "{output}");
    assert!(
        output.contains("listening for workers on 127.0.0.1:"),
        "{output}"
    );

    // Stopped in its first and second part, and restarted until complete.
    let parts = at("parts");
    let model = || ModelFolder::open(parts.to_str().unwrap()).unwrap();
    let output = stopped(
        &mut train_model(&data, &cache, &parts),
        "INT",
        "autoencoder",
    );
    assert!(output.contains("no transition model yet"), "{output}");
    assert!(output.contains("transition   not begun"), "{output}");
    let [autoencoder] = &model().unfinished().unwrap()[..] else {
        panic!("{output}");
    };
    assert_eq!((&*autoencoder.part, autoencoder.steps), ("autoencoder", 20));
    assert!(
        output.contains(&format!("autoencoder  {autoencoder}")),
        "{output}"
    );
    model().decoder().unwrap();
    assert!(model().require_transition().is_err());

    let output = stopped(
        &mut train_model(&data, &cache, &parts),
        "TERM",
        "transition",
    );
    assert!(output.contains("autoencoder  done"), "{output}");
    assert!(output.contains("idm          not begun"), "{output}");
    assert!(
        output.contains(&format!("wm model info {}", parts.display())),
        "{output}"
    );
    let [transition] = &model().unfinished().unwrap()[..] else {
        panic!("{output}");
    };
    assert_eq!((&*transition.part, transition.steps), ("transition", 12));
    // It is still a model.
    model().world_model().unwrap();

    let output = done(&mut train_model(&data, &cache, &parts));
    assert!(model().unfinished().unwrap().is_empty(), "{output}");
    assert!(output.contains("resumes after step"), "{output}");
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
        // Its header has the origin.
        let header = String::from_utf8_lossy(&checkpoint[..checkpoint.len().min(1 << 16)]);
        assert!(header.contains(model), "{part} does not begin from {model}");
    }

    // Trained parts are measured by their own commands.
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
        let output = done(eval.arg("--cache").arg(&cache).arg("--data").arg(&bags));
        assert!(!output.is_empty(), "{part}");
    }
}

/// A training of a model on a semantic encoder: its name, the path of its base model, and its settings.
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

/// Each with a few steps, uninterrupted and interrupted: the encoder, the adapter of its features, the transition model of
/// its latents in the adapter's folder, and a student.
#[test]
fn resumed_semantic_trainings_give_the_same_bytes() {
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
            // A learning rate that does not depend on the length, so that pauses do not matter.
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

/// A process that ends with the test.
struct Running {
    process: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Running {
    fn start(command: &mut Command) -> Self {
        let mut process = command.stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(process.stdout.take().unwrap()).lines();
        Self { process, lines }
    }

    /// The next line of its output with `text`.
    fn line_with(&mut self, text: &str) -> String {
        let mut lines = self.lines.by_ref().map(Result::unwrap);
        let line = lines.find(|line| line.contains(text));
        line.unwrap_or_else(|| panic!("no line with {text}"))
    }

    /// Its exit code and the rest of its output.
    fn end(mut self) -> (Option<i32>, String) {
        let lines: Vec<String> = self.lines.by_ref().map(Result::unwrap).collect();
        let code = self.process.wait().unwrap().code();
        (code, lines.join("\n"))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It has usually ended.
        self.process.kill().ok();
        self.process.wait().ok();
    }
}

/// Workers are killed and refused, and the training is interrupted.
#[test]
fn several_processes_give_the_same_bytes_as_one() {
    let scratch = tempfile::tempdir().unwrap();
    let at = |name: &str| scratch.path().join(name);
    let (bags, cache) = (at("bags"), at("cache"));
    let sim = ["sim", "--episodes", "2", "--frames", "24", "--out"];
    done(wm_training().args(sim).arg(&bags));
    let on_data = |command: &[&str]| {
        let mut process = wm_training();
        process.arg("train").args(command);
        process.args(["--threads", "1", "--validation", "0", "--encoder", "tiny"]);
        process.arg("--data").arg(&bags).arg("--cache").arg(&cache);
        process
    };
    let train = |out: &str| {
        let mut process = on_data(&["transition", "--steps", "100"]);
        process.arg("--out").arg(at(out));
        for setting in [
            "batch=4",
            "micro_batch=1",
            "model.hidden=32",
            "model.depth=1",
            "model.heads=2",
            "model.frames=5",
        ] {
            process.args(["--set", setting]);
        }
        process
    };
    let begin = |out: &str, workers: &str| {
        let listen = ["--listen", "127.0.0.1:0", "--workers", workers];
        let mut training = Running::start(train(out).args(listen));
        let line = training.line_with("listening for workers on ");
        let address = line
            .split([' ', ','])
            .find(|word| word.contains("127.0.0.1:"));
        (training, address.unwrap().to_owned())
    };
    let expect_same = |out: &str| {
        for file in [
            "transition.safetensors",
            "transition.checkpoint.safetensors",
            "transition.journal.jsonl",
        ] {
            let read = |out: &str| std::fs::read(at(out).join(file)).unwrap();
            assert!(read("alone") == read(out), "{out}: {file}");
        }
    };
    done(&mut train("alone"));

    // Of other data, although it would join.
    let (mut training, address) = begin("shared", "2");
    let other = on_data(&["worker", &address, "--shift-actions", "1"]).output();
    let error = String::from_utf8(other.unwrap().stderr).unwrap();
    assert!(error.contains("of the coordinator"), "{error}");
    training.line_with("refused a worker at 127.0.0.1:");
    let worker = || Running::start(&mut on_data(&["worker", &address]));
    let (first, mut second) = (worker(), worker());
    training.line_with("joined: 2 workers");
    second.process.kill().unwrap();
    let (code, output) = training.end();
    assert_eq!(code, Some(0), "{output}");
    let (code, output) = first.end();
    assert!(output.contains("is finished"), "{output}");
    assert!(output.contains("computed "), "{output}");
    assert_eq!(code, Some(0), "{output}");
    expect_same("shared");

    let (mut training, address) = begin("stopped", "1");
    let worker = Running::start(&mut on_data(&["worker", &address]));
    training.line_with("joined: 1 worker");
    let pid = training.process.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-s", "INT", &pid])
            .status()
            .unwrap()
            .success()
    );
    let (code, output) = training.end();
    assert!(output.contains("the same command resumes"), "{output}");
    assert_eq!(code, Some(130), "{output}");
    let (code, output) = worker.end();
    assert!(output.contains("is stopped and saved"), "{output}");
    assert_eq!(code, Some(130), "{output}");
    done(&mut train("stopped"));
    expect_same("stopped");
}

#[test]
fn wrong_setting_is_named_first() {
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
    let output = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.contains("decoder.batch=1") && output.contains("autoencoder, transition"),
        "{output}"
    );
}

/// Including those of the last part, hours later.
#[test]
fn faults_of_later_parts_are_named_first() {
    let scratch = tempfile::tempdir().unwrap();
    let (data, out) = (scratch.path().join("data"), scratch.path().join("out"));
    for (wrong, named) in [
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
        assert!(error.contains(named), "{wrong:?}: {error}");
        assert!(output.stdout.is_empty(), "{wrong:?}: a part has begun");
        assert!(!out.exists(), "{wrong:?}");
    }
    // Data too: once, by name, with the expectation.
    let train = |more: &[&str]| {
        let mut train = wm_training();
        train.args(["train", "model"]).args(more);
        train.arg("--data").arg(&data).arg("--out").arg(&out);
        let output = train.output().unwrap();
        assert_eq!(output.status.code(), Some(1));
        assert!(output.stdout.is_empty(), "a part has begun");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let error = train(&[]);
    assert_eq!(error.matches("no such file").count(), 1, "{error}");
    assert!(error.contains(data.to_str().unwrap()), "{error}");
    assert!(error.contains("wm dataset BAGS --out FOLDER"), "{error}");
    std::fs::create_dir(&data).unwrap();
    let error = train(&[]);
    assert!(error.contains("found no recording"), "{error}");
    // An address of another machine, too, and files that a later part would replace.
    std::fs::create_dir(data.join("bag")).unwrap();
    std::fs::write(data.join("bag/metadata.yaml"), "").unwrap();
    let error = train(&["--listen", "192.0.2.1:7450"]);
    assert!(error.contains("--listen 192.0.2.1:7450"), "{error}");
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("idm.safetensors"), "theirs").unwrap();
    let error = train(&[]);
    assert!(error.contains("idm.safetensors is there"), "{error}");
}

/// The completions and man pages of `wm` use it.
#[test]
fn program_describes_its_command_line() {
    let program = Path::new(env!("CARGO_BIN_EXE_wm-training"));
    let output = wm_program::command_line::query(program).unwrap();
    output.clone().debug_assert();
    let model = ["train", "model"]
        .iter()
        .try_fold(&output, |command, word| command.find_subcommand(word));
    let flags = model.unwrap().get_arguments();
    let flags: Vec<&str> = flags.filter_map(clap::Arg::get_long).collect();
    for flag in ["data", "out", "share", "validation"] {
        assert!(flags.contains(&flag), "{flag}: {flags:?}");
    }
    let eval = output.find_subcommand("eval").unwrap();
    assert!(eval.find_subcommand("imagined").is_some());
}
