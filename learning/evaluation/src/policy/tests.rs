//! The whole loop: the embedded model on small bags.
#![allow(clippy::unwrap_used)]

mod judges;
#[allow(dead_code, reason = "the tests of the protocol use all of it")]
#[path = "../../tests/protocol/server.rs"]
mod server;

use std::{fs, path::Path};

use image::{Rgb, RgbImage};
use tempfile::TempDir;
use wm_dataset::{
    DataOptions, HeldOutArgs,
    testing::{Recorder, write_reds},
};
use wm_metrics::findings::{Section, Suite};

use super::{PolicyArgs, Setup, Trials, arguments::BuiltIn, *};
use crate::{CONTEXT, Protocol, ReaderArgs, Settings, Shard, Subject, records, run};

/// Instructions known to the bundled probe.
const INSTRUCTIONS: [&str; 2] = ["pick up the red box", "push the blue box to the left"];
const TASKS: &str = "levels: {1: Short, 2: Long}
tasks:
  - {instruction: Pick up the red box, level: 1, ood_instruction: push the red box to the left, variation: Action}
  - {instruction: push the blue box to the left, level: 2}
";

/// The embedded model on two bags (the first is a success), and one without an instruction.
struct Bags {
    dir: TempDir,
    subject: Subject,
}

impl Bags {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let bags = dir.path().join("bags");
        for (number, instruction) in INSTRUCTIONS.into_iter().enumerate() {
            let mut recorder = Recorder::new(&bags.join(format!("bag_{number}")));
            recorder.text("/task/instruction", 0, instruction);
            recorder.run(0..10);
            recorder.success(1800, number == 0);
            recorder.finish();
        }
        write_reds(&bags.join("bag_2"), &[10; 10]);
        let on = HeldOutArgs {
            data: vec![bags],
            options: DataOptions::default(),
            cache: Some(dir.path().join("cache")),
        };
        let subject = Subject::open("tiny", &on, &ReaderArgs::default()).unwrap();
        Self { dir, subject }
    }

    fn write(&self, name: &str, text: &str) -> std::path::PathBuf {
        let path = self.dir.path().join(name);
        fs::write(&path, text).unwrap();
        path
    }

    /// The written records of all trials, and their section.
    fn run(&self, arguments: &PolicyArgs, folder: &str) -> anyhow::Result<(Vec<String>, Section)> {
        let mut setup = Setup::new(arguments)?;
        if setup.has_probes_judge() {
            setup = setup.with_probes(self.subject.readers.judges())?;
        }
        let mut settings = Settings::of(Protocol::Quick, 5);
        settings.resamples = 100;
        let own = &mut settings.policy;
        (own.steps, own.trials, own.strips) = (3, 2, 1);
        own.inputs = setup.inputs().clone();
        let records = (&*self.dir.path().join(folder), Shard::WHOLE);
        let path = run::measure(
            &self.subject,
            (&[], 0),
            &[Suite::Policy],
            &settings,
            &setup,
            records,
        )?;
        let mut lines: Vec<String> = fs::read_to_string(&path)?
            .lines()
            .map(str::to_owned)
            .collect();
        lines.sort();
        let (heading, found) = records::merge(vec![{
            let (heading, found) = records::read(&path)?;
            (path, heading, found)
        }])?;
        let section = run::findings(heading, found)?.sections.remove(0);
        Ok((lines, section))
    }
}

fn of(policy: BuiltIn) -> PolicyArgs {
    PolicyArgs {
        policy,
        policy_timeout: 600,
        ..PolicyArgs::default()
    }
}

fn command(command: &str) -> PolicyArgs {
    PolicyArgs {
        policy_command: Some(command.into()),
        ..of(BuiltIn::Recorded)
    }
}

fn example() -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let script = root.join("examples/imagined_policy/policy.py");
    format!("python3 '{}' --down 1", script.display())
}

fn threads(count: usize) -> rayon::ThreadPool {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(count);
    pool.build().unwrap()
}

#[test]
fn results_depend_on_policies_but_not_threads() {
    let bags = Bags::new();
    let mut of_each = Vec::new();
    for (name, policy) in [
        ("recorded", of(BuiltIn::Recorded)),
        ("still", of(BuiltIn::Still)),
        ("example", command(&example())),
    ] {
        let run = |count| {
            let folder = format!("{name} of {count}");
            threads(count).install(|| bags.run(&policy, &folder).unwrap())
        };
        let (alone, section) = run(1);
        assert_eq!(alone, run(2).0, "{name}");
        // A heading, and two trials of two tasks: the third bag has no instruction.
        assert_eq!(alone.len(), 5, "{name}");
        assert_eq!(section.pictures.len(), 1, "{name}");
        let probability = &section.metrics["policy.probe_probability"];
        assert_eq!((probability.n, probability.samples.len()), (4, 2), "{name}");
        let has_recorded = section
            .metrics
            .contains_key("policy.recorded_agreement_with_outcome");
        assert_eq!(has_recorded, name == "recorded");
        let absent: Vec<&str> = section.absent.iter().map(|a| &*a.metric).collect();
        assert!(absent.contains(&"policy.consensus_success"), "{absent:?}");
        of_each.push(alone);
    }
    assert_ne!(of_each[0], of_each[1]);
    assert_ne!(of_each[1], of_each[2]);
}

#[test]
fn recorded_policy_gives_the_recorded_rollout() {
    let bags = Bags::new();
    let setup = Setup::new(&of(BuiltIn::Recorded)).unwrap();
    let settings = Settings::of(Protocol::Quick, 0);
    let records = (bags.dir.path(), Shard::WHOLE);
    let trials = Trials::new(&bags.subject, &settings, &setup, records).unwrap();
    assert_eq!(trials.names()[1], "bag_0 trial 1");
    let imagined = trials.latents(0, 2).unwrap();
    let recording = bags.subject.recording(0, CONTEXT + 2).unwrap();
    let rollout = bags
        .subject
        .rollout(&recording, trial::seed(0, "bag_0", 0))
        .unwrap();
    let values = |tensor: &candle_core::Tensor| -> Vec<f32> {
        tensor.flatten_all().unwrap().to_vec1().unwrap()
    };
    assert_eq!(
        values(&imagined.narrow(0, CONTEXT, 2).unwrap()),
        values(&rollout)
    );
}

#[test]
fn ood_trials_accompany_the_others() {
    let bags = Bags::new();
    let images = bags.dir.path().join("images");
    fs::create_dir(&images).unwrap();
    let picture = RgbImage::from_fn(64, 48, |x, y| Rgb([x as u8, y as u8, 200]));
    picture.save(images.join("bag_1.png")).unwrap();
    let arguments = PolicyArgs {
        tasks: Some(bags.write("tasks.yaml", TASKS)),
        ood: Some(arguments::OutOfDistribution::Instruction),
        start_images: Some(images.clone()),
        ..of(BuiltIn::Still)
    };
    let (lines, section) = bags.run(&arguments, "records").unwrap();
    assert_eq!(lines.len(), 1 + 4 + 2 + 2);
    for name in [
        "bag_0 trial 1, other instruction",
        "bag_1 trial 0, other first frame",
    ] {
        assert!(lines.iter().any(|line| line.contains(name)), "{name}");
    }
    let metrics = &section.metrics;
    let instruction = &metrics["policy.ood_instruction_probe_probability"];
    assert_eq!((instruction.n, instruction.samples.len()), (2, 1));
    // Equal latents under equal seeds with another instruction; other latents with another frame.
    for name in ["ood_instruction", "ood_distractor"] {
        let drop = &metrics[&format!("policy.{name}_probe_probability_drop")];
        assert_ne!(drop.value, 0.0, "{name}");
    }
    let levels = &section.tables[0];
    assert_eq!(levels.rows[0][..3], ["1: Short", "1", "2"]);

    fs::rename(images.join("bag_1.png"), images.join("other.png")).unwrap();
    let error = bags.run(&arguments, "others").unwrap_err().to_string();
    assert!(
        error.contains("other, ...") && error.contains("bag_0, bag_1"),
        "{error}"
    );
    let unknown = PolicyArgs {
        tasks: Some("bridge_v2".into()),
        ..of(BuiltIn::Still)
    };
    let error = bags.run(&unknown, "unknown").unwrap_err().to_string();
    assert!(
        error.contains("\"close oven\"") && error.contains("pick up"),
        "{error}"
    );
}

#[test]
fn failing_program_ends_the_run_with_its_trial_named() {
    let bags = Bags::new();
    for (line, named) in [
        ("false", "it ended its output"),
        (
            "no_such_program_anywhere",
            "no_such_program_anywhere cannot be started",
        ),
        ("echo ready", "got `ready`"),
        ("printf '{'", "it ended within an answer"),
        (r#"echo '{"action": [0, 0]}'"#, "action 0"),
        (r#"echo '{"action": [9, 0, 0, 0, 0, 0, 0]}'"#, "dx"),
        (
            r#"echo '{"error": "no GPU"}'"#,
            "the policy reports: `no GPU`",
        ),
        // Echoes the request.
        ("cat", "unknown field `version`"),
    ] {
        let error = threads(1).install(|| bags.run(&command(line), line).unwrap_err());
        let error = format!("{error:#}");
        assert!(error.contains(named), "{line}: {error}");
        assert!(
            error.contains("task bag_0, trial 0, step 0"),
            "{line}: {error}"
        );
    }
}

#[test]
fn unusable_inputs_are_rejected_first() {
    let refused = |arguments: PolicyArgs| format!("{:#}", Setup::new(&arguments).unwrap_err());
    assert!(refused(command("a 'b")).contains("unclosed quote"));
    let zero = PolicyArgs {
        trials: Some(0),
        ..of(BuiltIn::Still)
    };
    assert!(refused(zero).contains("--trials"));
    for file in ["tasks", "judges", "images"] {
        let path = Some(std::path::PathBuf::from(format!("/nowhere/{file}")));
        let arguments = PolicyArgs {
            tasks: path.clone().filter(|_| file == "tasks"),
            judges: path.clone().filter(|_| file == "judges"),
            start_images: path.filter(|_| file == "images"),
            ..of(BuiltIn::Still)
        };
        assert!(
            refused(arguments).contains(&format!("/nowhere/{file}")),
            "{file}"
        );
    }
}
