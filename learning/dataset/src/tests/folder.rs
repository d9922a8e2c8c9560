//! Prepared folders.

use std::{
    fs,
    path::{Path, PathBuf},
    slice::from_ref,
};

use clap::Parser;
use proptest::prelude::*;
use wm_model::{Fit, Framing};
use wm_motion::actions::ActionSpace;

use super::{
    super::{
        Cut, Data, DataOptions, DataStatistics, Dataset, DatasetArgs, LeftOut, Manifest,
        ManifestEpisode, Settings, Size, Source, SourceSize, Split, SplitRule, StampSource, Thing,
        store::{NewFolder, is_prepared, read_manifest},
    },
    outcome::Outcome,
};
use crate::testing::{CAMERA, Recorder};

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    arguments: DatasetArgs,
}

pub(super) fn wm_dataset(arguments: &[&str]) -> anyhow::Result<()> {
    let arguments = ["wm dataset"].iter().chain(arguments);
    Cli::try_parse_from(arguments)?.arguments.run()
}

/// Bags `episode_0` and so on; the first has four frames, each next one more.
fn bags(dir: &Path, count: i64) -> PathBuf {
    let bags = dir.join("bags");
    for number in 0..count {
        let mut recorder = Recorder::new(&bags.join(format!("episode_{number}")));
        recorder.text("/task/instruction", 0, "stack the cubes");
        recorder.run(0..4 + number);
        recorder.success(800 + number * 200, number % 2 == 0);
        recorder.finish();
    }
    bags
}

fn entries(dir: &Path) -> Vec<String> {
    let entries = fs::read_dir(dir).unwrap();
    let mut names: Vec<String> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// Prepares bags with pictures of 16x16 pixels.
fn prepare_small(bags: &Path, out: &Path) {
    let [bags, out] = [bags, out].map(|path| path.to_str().unwrap());
    wm_dataset(&[bags, "-o", out, "--size", "16x16"]).unwrap();
}

#[test]
fn prepared_folder_equals_its_bags() {
    let dir = tempfile::tempdir().unwrap();
    let bags = bags(dir.path(), 8);
    let out = dir.path().join("data");
    let (bags_text, out_text) = (bags.to_str().unwrap(), out.to_str().unwrap());
    let line = [
        bags_text,
        "-o",
        out_text,
        "--size",
        "16x16",
        "--validation",
        "0.3",
    ];
    wm_dataset(&line).unwrap();
    let names = [
        "action_space.json",
        "actions",
        "audit.json",
        "dataset.json",
        "frames",
        "statistics.json",
    ];
    assert_eq!(entries(&out), names);

    let cache = dir.path().join("cache");
    let options = DataOptions {
        validation: Some(0.3),
        ..DataOptions::default()
    };
    let framing = Framing::new((16, 16), Fit::Crop);
    let direct = Data::open(from_ref(&bags), framing, &cache, &options).unwrap();
    let prepared = Data::open(from_ref(&out), framing, &cache, &DataOptions::default()).unwrap();
    let validation = direct.validation.unwrap();
    for (direct, prepared) in [
        (&direct.training, &prepared.training),
        (&validation, prepared.validation.as_ref().unwrap()),
    ] {
        assert_eq!(direct.episodes(), prepared.episodes());
        assert_eq!(direct.digest(), prepared.digest());
        for frame in 0..direct.frame_count() {
            assert_eq!(direct.frame(frame), prepared.frame(frame));
        }
    }
    assert_eq!(
        direct.training.episodes().len() + validation.episodes().len(),
        8
    );
    let only = Dataset::held_out(from_ref(&out), (16, 16), &cache, &options).unwrap();
    assert_eq!(only.episodes(), validation.episodes());
    // The same options find the validation episodes of a training on bags.
    let only = Dataset::held_out(from_ref(&bags), (16, 16), &cache, &options).unwrap();
    assert_eq!(only.episodes(), validation.episodes());
    let default = DataOptions::default();
    let all = Dataset::held_out(from_ref(&bags), (16, 16), &cache, &default).unwrap();
    assert_eq!(all.episodes().len(), 8);

    // The folder's action space is valid input.
    let text = fs::read(out.join("statistics.json")).unwrap();
    let statistics: DataStatistics = serde_json::from_slice(&text).unwrap();
    let options = DataOptions {
        action_space: Some(out.join("action_space.json")),
        ..DataOptions::default()
    };
    let fitted = Data::open(from_ref(&out), (16, 16), &cache, &options).unwrap();
    assert_eq!(fitted.training.action_space(), &statistics.action_space);
    assert_eq!(statistics.action_space.dimensions()[0].scale, 100.0);
    assert_eq!(statistics.names[0], "dx");
    let episodes = statistics.instructions.get("stack the cubes").copied();
    assert_eq!(episodes, Some(direct.training.episodes().len()));

    // Existing folders are never overwritten, and ineffective options are rejected.
    let error = wm_dataset(&line).unwrap_err().to_string();
    assert!(error.contains("exists already"), "{error}");
    let options = DataOptions {
        cut_seconds: Some(1.0),
        ..DataOptions::default()
    };
    let error = Data::open(from_ref(&out), (16, 16), &cache, &options).unwrap_err();
    assert!(error.to_string().contains("--cut-seconds"), "{error}");
    let file = dir.path().join("options.yaml");
    fs::write(&file, "cut-seconds: 1\n").unwrap();
    let options = DataOptions {
        config: Some(file),
        ..DataOptions::default()
    };
    Data::open(from_ref(&out), (16, 16), &cache, &options).unwrap();
    wm_dataset(&["info", out_text]).unwrap();
}

#[test]
fn held_out_bags_are_validation_of_a_prepared_folder() {
    let dir = tempfile::tempdir().unwrap();
    let bags = bags(dir.path(), 5);
    let copy = dir.path().join("copy");
    fs::create_dir(&copy).unwrap();
    for file in fs::read_dir(bags.join("episode_1")).unwrap() {
        let file = file.unwrap();
        fs::copy(file.path(), copy.join(file.file_name())).unwrap();
    }
    let out = dir.path().join("data");
    let prepare = |held_out: &Path| {
        wm_dataset(&[
            bags.to_str().unwrap(),
            "--held-out",
            held_out.to_str().unwrap(),
            "-o",
            out.to_str().unwrap(),
        ])
    };
    let error = prepare(&copy).unwrap_err().to_string();
    assert!(error.contains("copy: held out, but"), "{error}");
    // Validation bags are removed from the training bags.
    prepare(&bags.join("episode_3")).unwrap();
    let manifest = read_manifest(&out).unwrap();
    let validation = manifest
        .episodes
        .iter()
        .filter(|e| e.split == Split::Validation);
    let names: Vec<&str> = validation.map(|e| &*e.name).collect();
    assert_eq!(names, ["episode_3"]);
}

#[test]
fn digest_of_recordings_is_that_of_bags_and_settings() {
    let dir = tempfile::tempdir().unwrap();
    let bags = bags(dir.path(), 2);
    let cache = dir.path().join("cache");
    let open = |framing: Framing, options: &DataOptions| {
        let data = Data::open(from_ref(&bags), framing, &cache, options).unwrap();
        let digest = data.training.digest().to_owned();
        (data.training.recordings_digest().to_owned(), digest)
    };
    let options = DataOptions::default();
    let small = open(Framing::from((8, 8)), &options);
    let large = open(Framing::from((16, 16)), &options);
    assert_eq!(small.0, large.0);
    assert_ne!(small.1, large.1);
    let shifted = DataOptions {
        shift_actions: Some(1),
        ..DataOptions::default()
    };
    assert_ne!(open(Framing::from((8, 8)), &shifted).0, small.0);
}

#[test]
fn prepared_pictures_shrink_and_never_grow() {
    let dir = tempfile::tempdir().unwrap();
    let bags = bags(dir.path(), 2);
    let out = dir.path().join("data");
    wm_dataset(&[
        bags.to_str().unwrap(),
        "-o",
        out.to_str().unwrap(),
        "--size",
        "32x24",
        "--fit",
        "stretch",
    ])
    .unwrap();
    let cache = dir.path().join("cache");
    let open = |size| {
        let paths = [out.clone()];
        let options = DataOptions::default();
        Data::open(&paths, size, &cache, &options).map(|data| data.training)
    };
    for _ in 0..2 {
        let small = open((8, 8)).unwrap();
        assert_eq!(small.size(), (8, 8));
        let frame = small.episodes()[0].frame_count - 1;
        let expected = [frame as u8, 20, 30].repeat(64);
        assert_eq!(small.frame(frame), Some(&*expected));
        assert_eq!(entries(&cache).len(), 1, "made once");
    }
    let error = open((32, 32)).unwrap_err().to_string();
    assert!(
        error.contains("32x24") && error.contains("32x32"),
        "{error}"
    );
}

#[test]
fn shards_are_joined_by_the_command_without_shard() {
    let dir = tempfile::tempdir().unwrap();
    let bags = bags(dir.path(), 5);
    let prepared = |name: &str| {
        let out = dir.path().join(name);
        let (bags, text) = (bags.to_str().unwrap(), out.to_str().unwrap());
        wm_dataset(&[bags, "-o", text, "--size", "128x128"]).unwrap();
        out
    };
    let latents = |out: &Path, more: &[&str]| {
        let line = ["latents", out.to_str().unwrap(), "--encoder", "tiny"];
        wm_dataset(&[&line, more].concat()).unwrap();
    };
    let (one, shared) = (prepared("one"), prepared("shared"));
    latents(&one, &[]);
    let (names, statistics) = (entries(&shared), fs::read(shared.join("statistics.json")));
    // 30 frames are two batches.
    for shard in ["0/3", "1/3", "2/3"] {
        latents(&shared, &["--shard", shard]);
    }
    let parts = entries(&shared);
    let parts: Vec<_> = parts.iter().filter(|name| !names.contains(name)).collect();
    assert!(
        parts.len() == 2
            && parts[0].ends_with(".frames-0-16")
            && parts[1].ends_with(".frames-16-14"),
        "{parts:?}"
    );
    let read = |out: &Path, name: &str| fs::read(out.join(name)).unwrap();
    assert_eq!(read(&shared, "statistics.json"), statistics.unwrap());
    latents(&shared, &[]);
    assert_eq!(entries(&shared), entries(&one));
    for name in entries(&one) {
        assert!(
            name == "dataset.json" || read(&shared, &name) == read(&one, &name),
            "{name}"
        );
    }
}

#[test]
fn folders_and_bags_form_one_data_set() {
    let dir = tempfile::tempdir().unwrap();
    let bags = bags(dir.path(), 3);
    let out = dir.path().join("data");
    let first = bags.join("episode_0");
    prepare_small(&first, &out);
    let options = DataOptions {
        validation: Some(0.0),
        ..DataOptions::default()
    };
    let paths = [bags.join("episode_1"), out, bags.join("episode_2")];
    let data = Data::open(&paths, (16, 16), &dir.path().join("cache"), &options).unwrap();
    let training = data.training;
    assert_eq!(training.frame_count(), 15);
    let names: Vec<&str> = training.episodes().iter().map(|e| &*e.name).collect();
    assert_eq!(names, ["episode_0", "episode_1", "episode_2"]);
    let reds: Vec<u8> = (0..15).map(|i| training.frame(i).unwrap()[0]).collect();
    assert_eq!(reds, [0, 1, 2, 3, 0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 5]);
    assert_eq!(training.frame(15), None);
}

/// A recorder killed during compression leaves a file in two forms.
#[test]
fn file_in_two_forms_is_one_bag() {
    let dir = tempfile::tempdir().unwrap();
    let bags = bags(dir.path(), 1);
    let loose = dir.path().join("loose");
    fs::create_dir(&loose).unwrap();
    let file = bags.join("episode_0/episode_0_0.mcap");
    for name in ["run_0.mcap", "run_0.mcap.zstd"] {
        fs::copy(&file, loose.join(name)).unwrap();
    }
    let outcome = Outcome::of(&loose, DataOptions::default()).unwrap();
    assert_eq!(outcome.lengths(), [4]);
    let left = outcome.left_out();
    for named in ["run_0.mcap.zstd: the same file", "run_0.mcap is read"] {
        assert!(left.contains(named), "{named}: {left}");
    }
}

#[test]
fn adding_episodes_moves_no_others() {
    let dir = tempfile::tempdir().unwrap();
    let bags = bags(dir.path(), 12);
    let cache = dir.path().join("cache");
    let options = DataOptions {
        validation: Some(0.4),
        ..DataOptions::default()
    };
    let held_out = |options: &DataOptions| {
        let data = Data::open(from_ref(&bags), (16, 16), &cache, options).unwrap();
        let validation = data.validation.unwrap();
        let names = validation.episodes().iter().map(|e| e.name.clone());
        names.collect::<std::collections::BTreeSet<_>>()
    };
    let before = held_out(&options);
    assert!((1..12).contains(&before.len()), "{before:?}");
    assert_eq!(held_out(&options), before);
    // Another split decodes nothing again.
    let made = entries(&cache);
    let other = DataOptions {
        validation_seed: Some(1),
        ..options.clone()
    };
    assert_ne!(held_out(&other), before);
    assert_eq!(entries(&cache), made);
    for number in 12..16 {
        let mut recorder = Recorder::new(&bags.join(format!("episode_{number}")));
        recorder.run(0..4 + number);
        recorder.finish();
    }
    assert!(held_out(&options).is_superset(&before));
}

#[test]
fn interrupted_preparations_are_ignored() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("data");
    // The remains of a killed program.
    let folder = NewFolder::create(&out).unwrap();
    folder.create_file("frames").unwrap();
    folder.write_actions(&[vec![0.0; 7]]).unwrap();
    assert!(!out.exists());
    let [left] = entries(dir.path()).try_into().unwrap();
    assert!(!is_prepared(&dir.path().join(&left)), "{left}");
    drop(folder);
    assert_eq!(entries(dir.path()), Vec::<String>::new());

    // A failed preparation leaves nothing.
    let bags = bags(dir.path(), 2);
    let mut recorder = Recorder::new(&bags.join("other"));
    recorder.frame("/front/image_raw/compressed", 0, 1);
    recorder.action(0, 0.0);
    recorder.finish();
    wm_dataset(&[bags.to_str().unwrap(), "-o", out.to_str().unwrap()]).unwrap_err();
    assert_eq!(entries(dir.path()), ["bags"]);

    // A folder with a missing file is rejected.
    let first = bags.join("episode_0");
    prepare_small(&first, &out);
    let file = fs::OpenOptions::new().write(true).open(out.join("frames"));
    file.unwrap().set_len(1000).unwrap();
    let open = || {
        Dataset::open(&out, dir.path(), (16, 16))
            .unwrap_err()
            .to_string()
    };
    let error = open();
    assert!(error.contains("expected 3072 bytes, found 1000"), "{error}");
    let manifest = fs::read_to_string(out.join("dataset.json")).unwrap();
    let older = manifest.replace("\"version\": 4", "\"version\": 2");
    fs::write(out.join("dataset.json"), older).unwrap();
    let error = open();
    assert!(error.contains("expected version 4, found 2"), "{error}");
}

/// The numbers are numpy's: `numpy.quantile([1, 2, 3, 4, 10], [.01, .1, .5, .9, .99])`, `mean`, `std`.
#[test]
fn statistics_are_of_the_training_episodes() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let mut recorder = Recorder::new(&bag);
    for (frame, dx) in [10.0, 3.0, 1.0, 4.0, 2.0].into_iter().enumerate() {
        recorder.frame(CAMERA, frame as i64 * 200, 1);
        recorder.action(frame as i64 * 200, dx / 100.0);
    }
    recorder.finish();
    let outcome = Outcome::of(&bag, DataOptions::default()).unwrap();
    let statistics = outcome.data.training.statistics().unwrap();
    let action = &statistics.action;
    for (found, expected) in [
        (&action.min, 1.0),
        (&action.max, 10.0),
        (&action.mean, 4.0),
        (&action.std, 10_f64.sqrt()),
        (&action.q01, 1.04),
        (&action.q10, 1.4),
        (&action.q50, 3.0),
        (&action.q90, 7.6),
        (&action.q99, 9.76),
    ] {
        assert_eq!(found.len(), 7);
        assert!(
            (found[0] * 100.0 - expected).abs() < 1e-5,
            "{found:?} {expected}"
        );
    }
    assert_eq!(action.count, [5]);
    let fitted = statistics.action_space.dimensions();
    assert!((fitted[0].scale - 1.0 / 0.0976).abs() < 1e-3);
    // Constant dimensions and binary grippers are not scaled.
    let bridge = ActionSpace::bridge();
    assert_eq!(fitted[1], bridge.dimensions()[1]);
    assert_eq!(fitted[6], bridge.dimensions()[6]);
}

prop_compose! {
    fn episodes()(
        name in "[a-z#0-9]{1,12}",
        source in 0_usize..3,
        begin_ns in any::<i64>(),
        continues_ns in any::<Option<i64>>(),
        frames in 0_usize..10_000,
        is_training in any::<bool>(),
        instruction in proptest::option::of("\\PC{0,20}"),
        success in any::<Option<bool>>(),
    ) -> ManifestEpisode {
        let split = if is_training { Split::Training } else { Split::Validation };
        ManifestEpisode {
            name, source, begin_ns, continues_ns, end_ns: begin_ns, frames, split, instruction, success, labels: std::collections::BTreeMap::new(),
        }
    }
}

prop_compose! {
    fn manifests()(
        episodes in prop::collection::vec(episodes(), 0..6),
        left_out in prop::collection::vec(
            (any::<Option<(i64, i64)>>(), proptest::option::of((any::<u64>(), Just(Thing::Frame))), "\\PC{0,30}"), 0..4),
        cameras in prop::collection::vec("/[a-z]{1,8}", 1..4),
        (height, width) in (1_usize..4096, 1_usize..4096),
        // Few digits, since longer decimals may be read with rounding.
        (eighths, seed, cut, has_masks) in (8_u32..800, any::<u64>(), any::<bool>(), any::<bool>()),
    ) -> Manifest {
        let space = ActionSpace::bridge();
        Manifest {
            version: 4,
            digest: "ab".repeat(32),
            size: Size { height, width },
            fit: Fit::ALL[height % 3],
            source_sizes: cameras
                .iter()
                .map(|camera| SourceSize { camera: camera.clone(), size: Size { height, width }.into(), pictures: seed })
                .collect(),
            cameras: cameras.clone(),
            has_masks,
            settings: Settings {
                cameras,
                action_topic: "/wm/action".into(),
                action_space: cut.then(|| space.clone()),
                stamps: if cut { StampSource::Log } else { StampSource::Header },
                shift_actions: i64::from(eighths % 5) - 2,
                cut: if cut { vec![Cut::Instruction] } else { Vec::new() },
                cut_topics: Vec::new(),
                cut_seconds: cut.then_some(f64::from(eighths) / 8.0),
                gap_periods: f64::from(eighths) / 8.0,
                min_seconds: 0.5,
            },
            split: SplitRule { validation: 0.125, seed },
            action_space: space,
            sources: vec![Source { bag: "a/b".into(), digest: "cd".into(), held_out: cut }],
            episodes,
            left_out: left_out
                .into_iter()
                .map(|(span_ns, count, reason)| LeftOut { path: "x".into(), span_ns, count, reason })
                .collect(),
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn manifest_round_trips(manifest in manifests()) {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("data");
        NewFolder::create(&folder).unwrap().finish(&manifest).unwrap();
        prop_assert_eq!(read_manifest(&folder).unwrap(), manifest);
    }
}
