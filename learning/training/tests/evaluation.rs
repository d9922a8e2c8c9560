//! `wm eval SUITE` with the embedded model on simulated bags.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use serde_json::Value;

/// A few seconds for everything.
const SMALL: &str = "
resamples: 200
fidelity: {episodes: 2, steps: 4, strips: 1}
control:
  searches: [{k: 1, windows: 2}, {k: 2, windows: 1}]
  population: 8
  iterations: 2
  elites: 2
  response_windows: 3
  response_steps: 4
latents: {windows: 3, steps: 4, judged_episodes: 3}
policy: {tasks: 2, trials: 2, steps: 3, strips: 1}
robustness: {windows: 2, steps: 2}
";

fn run(arguments: &[&str], paths: &[(&str, &Path)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wm-training"));
    command.args(arguments);
    for (flag, path) in paths {
        command.arg(flag).arg(path);
    }
    command.output().unwrap()
}

fn done(arguments: &[&str], paths: &[(&str, &Path)]) -> String {
    let found = run(arguments, paths);
    let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
    let (stdout, stderr) = (text(&found.stdout), text(&found.stderr));
    assert!(found.status.success(), "{arguments:?}\n{stdout}\n{stderr}");
    stdout
}

fn refused(arguments: &[&str], paths: &[(&str, &Path)]) -> String {
    let found = run(arguments, paths);
    assert_eq!(found.status.code(), Some(1), "{arguments:?}");
    String::from_utf8(found.stderr).unwrap()
}

/// Opens the report in a browser, wide and narrow, and checks that something is visible.
fn in_a_browser(report: &Path) {
    let browsers = ["chromium-headless-shell", "chromium", "google-chrome"];
    let version = |name: &&str| Command::new(name).arg("--version").output().is_ok();
    let Some(browser) = browsers.into_iter().find(version) else {
        assert!(
            std::env::var_os("CI").is_none(),
            "no browser, and this is not to be skipped in CI: tests/setup_system installs one"
        );
        eprintln!("skipped: none of {browsers:?} is installed");
        return;
    };
    let page = format!("file://{}", report.display());
    for width in [400, 1400] {
        let picture = report.with_extension(format!("{width}.png"));
        let found = Command::new(browser)
            .args(["--headless", "--no-sandbox", "--hide-scrollbars"])
            .arg(format!("--window-size={width},2400"))
            .arg(format!("--screenshot={}", picture.display()))
            .arg(&page)
            .output()
            .unwrap();
        assert!(
            found.status.success(),
            "{}",
            String::from_utf8_lossy(&found.stderr)
        );
        let picture = image::open(&picture).unwrap().into_rgb8();
        assert_eq!(picture.dimensions(), (width, 2400));
        // Text and lines on a background have many colours (anti-aliasing).
        let mut counts = std::collections::HashMap::new();
        for pixel in picture.pixels() {
            *counts.entry(pixel.0).or_insert(0_u32) += 1;
        }
        let most = counts.values().max().unwrap();
        assert!(counts.len() > 100, "{width}: {} colours", counts.len());
        assert!(
            f64::from(*most) < 0.97 * f64::from(width * 2400),
            "{width}: empty"
        );
    }
    let found = Command::new(browser)
        .args(["--headless", "--no-sandbox", "--dump-dom"])
        .arg(&page)
        .output()
        .unwrap();
    let dom = String::from_utf8_lossy(&found.stdout).into_owned();
    for part in [
        "Do predictions obey the actions?",
        "CEM error: distance to the true actions",
        "<svg",
        "data:image/png",
    ] {
        assert!(dom.contains(part), "{part}");
    }
}

#[test]
fn results_do_not_depend_on_threads_shards_or_interruptions() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let (bags, cache, settings) = (path("bags"), path("cache"), path("settings.yaml"));
    fs::write(&settings, SMALL).unwrap();
    let sim = [
        "sim",
        "--episodes",
        "6",
        "--frames",
        "30",
        "--failures",
        "0.5",
        "--seed",
        "77",
    ];
    done(&sim, &[("--out", &bags)]);

    let eval = |more: &[&str], paths: &[(&str, &Path)]| {
        let first = ["eval", "all", "--model", "tiny", "--skip", "cost"];
        let own: [(&str, &Path); 3] = [
            ("--bags", &bags),
            ("--cache", &cache),
            ("--settings", &settings),
        ];
        done(&[&first, more].concat(), &[&own, paths].concat())
    };
    let first = path("one");
    let printed = eval(&["--threads", "1"], &[("--report", &first)]);
    for figure in [
        "fidelity.psnr_ceiling",
        "control.cem_k1_error_from_zero",
        "control.cem_k2_error ",
        "control.ratio_k4_negated",
        "latents.idm_k1_r_predicted",
        "latents.success_balanced_accuracy_real",
        "robustness.psnr_gain_darker",
        "policy.probe_success",
        "control.cem_k2_error_idm",
    ] {
        assert!(printed.contains(figure), "{figure}\n{printed}");
    }
    let written = |folder: &Path| {
        ["report.html", "figures.json", "figures.csv"]
            .map(|name| fs::read_to_string(folder.join(name)).unwrap())
    };
    let expected = written(&first);
    let json: Value = serde_json::from_str(&expected[1]).unwrap();
    assert_eq!((&json["model"], &json["seed"]), (&"tiny".into(), &0.into()));
    assert_eq!(json["settings"]["control"]["population"], 8);
    let error = &json["metrics"]["control.cem_k1_error"];
    assert_eq!(error["n"], 2, "{error}");
    assert!(error["value"].as_f64().unwrap() > 0.0, "{error}");
    let psnr = &json["metrics"]["fidelity.psnr"]["value"];
    let ceiling = &json["metrics"]["fidelity.psnr_ceiling"]["value"];
    assert!(ceiling.as_f64() > psnr.as_f64(), "{psnr} {ceiling}");

    in_a_browser(&first.join("report.html"));

    // Two threads, and a run killed within a line.
    let second = path("two");
    eval(&["--threads", "2"], &[("--report", &second)]);
    assert_eq!(written(&second), expected);
    let records = fs::read_dir(second.join("records"))
        .unwrap()
        .next()
        .unwrap();
    let records = records.unwrap().path();
    let whole = fs::read(&records).unwrap();
    let third = path("three");
    let resumed = third.join("records").join(records.file_name().unwrap());
    fs::create_dir_all(third.join("records")).unwrap();
    fs::write(&resumed, &whole[..whole.len() / 2]).unwrap();
    eval(&[], &[("--report", &third)]);
    assert_eq!(written(&third), expected);

    // Two shards.
    let shards = path("shards");
    for shard in ["0/2", "1/2"] {
        if shard == "1/2" {
            let error = refused(
                &["eval", "merge"],
                &[("--json", &path("early.json")), ("--", &shards)],
            );
            assert!(
                error.contains("units are missing") && error.contains("0-of-2"),
                "{error}"
            );
        }
        eval(&["--shard", shard], &[("--records", &shards)]);
    }
    let fourth = path("four");
    done(
        &["eval", "merge"],
        &[("--report", &fourth), ("--", &shards)],
    );
    assert_eq!(written(&fourth), expected);

    // Existing files are kept, and other settings do not continue these records.
    let all = ["eval", "fidelity", "--model", "tiny"];
    let on: [(&str, &Path); 3] = [("--bags", &bags), ("--cache", &cache), ("--report", &first)];
    let error = refused(&all, &on);
    assert!(error.contains("report.html: exists already"), "{error}");
    for name in ["report.html", "figures.json", "figures.csv"] {
        fs::remove_file(first.join(name)).unwrap();
    }
    let error = refused(&all, &on);
    assert!(error.contains("of another evaluation"), "{error}");
    assert!(
        error.contains("header.settings.control.population"),
        "{error}"
    );
}

const ENCODER: &str =
    "micro_batch=1 model.patch=16 model.hidden=16 model.depth=1 head.hidden=16 head.width=8";
const ADAPTER: &str = "micro_batch=1 model.latent=4 model.layers=1 model.ffn=16 model.base=8 \
                       model.multipliers=[1,1,1,1,1] loss.kl_warm_up=0.0";

/// A semantic model of small untrained networks, inverse dynamics models of its latents and of its encoder's features, and a
/// linear probe.
#[test]
fn further_readers_use_latents_and_encoder_features() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let (bags, cache, settings) = (path("bags"), path("cache"), path("settings.yaml"));
    fs::write(&settings, SMALL).unwrap();
    let sim = "sim --episodes 6 --frames 24 --failures 0.5 --seed 77";
    done(&sim.split(' ').collect::<Vec<_>>(), &[("--out", &bags)]);
    let train = |what: &str, of: Option<&str>, out: &str, sets: &str| {
        let mut words = vec!["train", what, "--threads", "2", "--steps", "1"];
        words.extend(["--validation", "0", "--set", "batch=2"]);
        words.extend(sets.split(' ').flat_map(|set| ["--set", set]));
        let of = of.map(path);
        let out = path(out);
        let mut paths: Vec<(&str, &Path)> = vec![("--data", &bags), ("--cache", &cache)];
        paths.extend(of.iter().map(|of| ("--encoder", of.as_path())));
        paths.push(("--out", &out));
        done(&words, &paths);
    };
    train("encoder", None, "encoder", ENCODER);
    train("adapter", Some("encoder"), "model", ADAPTER);
    let transition = "model.hidden=32 model.depth=1 model.heads=2";
    train("transition", Some("model"), "model", transition);
    let idm = "micro_batch=1 model.hidden=16 model.width=8";
    train("idm", Some("encoder"), "native", idm);
    train(
        "idm",
        Some("model"),
        "chunks",
        &format!("{idm} model.horizon=4"),
    );
    train(
        "probe",
        Some("model"),
        "linear",
        "micro_batch=1 model.kind=linear",
    );

    let (model, report) = (path("model"), path("report"));
    let more = |of: &str| {
        path(of).join(format!(
            "{}.safetensors",
            if of == "linear" { "probe" } else { "idm" }
        ))
    };
    let (native, chunks, linear) = (more("native"), more("chunks"), more("linear"));
    let on: [(&str, &Path); 3] = [
        ("--bags", &bags),
        ("--cache", &cache),
        ("--settings", &settings),
    ];
    let readers: [(&str, &Path); 3] =
        [("--idm", &native), ("--idm", &chunks), ("--probe", &linear)];
    let own: [(&str, &Path); 2] = [("--model", &model), ("--report", &report)];
    done(&["eval", "latents"], &[&on[..], &readers, &own].concat());
    let json = fs::read_to_string(report.join("figures.json")).unwrap();
    let json: Value = serde_json::from_str(&json).unwrap();
    for name in [
        "idm_native_k1_r_real",
        "idm_native_k1_r_predicted",
        "idm_k4_r_real",
        "success_linear_auc_real",
        "success_linear_drop",
    ] {
        let figure = &json["metrics"][format!("latents.{name}")];
        assert!(figure["value"].is_number(), "{name}: {json}");
    }
    // Latents from the adapter's decoder do not suit the other model.
    assert!(json["metrics"]["latents.idm_k1_r_real"].is_null(), "{json}");
    let names: Vec<&String> = json["readers"].as_object().unwrap().keys().collect();
    assert_eq!(names, ["idm_k4", "idm_native_k1", "success_linear"]);

    // Records include their readers.
    fs::remove_file(report.join("report.html")).unwrap();
    fs::remove_file(report.join("figures.json")).unwrap();
    fs::remove_file(report.join("figures.csv")).unwrap();
    let fewer = refused(
        &["eval", "latents"],
        &[&on[..], &readers[..2], &own].concat(),
    );
    assert!(fewer.contains("header.readers.success_linear"), "{fewer}");
    // Each model takes its own; a file that suits none is named.
    let error = refused(
        &["eval", "latents", "--model", "tiny"],
        &[&on[..], &readers[..1]].concat(),
    );
    assert!(
        error.contains("native") && error.contains("expected `"),
        "{error}"
    );
}

/// The repository's semantic model is complete, and predicts the bundled bag better than persistence.
#[test]
fn bundled_semantic_model_beats_persistence() {
    let dir = tempfile::tempdir().unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let (model, bags) = (
        root.join("world-model/model/weights/semantic"),
        root.join("bags/tabletop"),
    );
    let (settings, json) = (dir.path().join("settings.yaml"), dir.path().join("f.json"));
    fs::write(&settings, SMALL).unwrap();
    let cache = dir.path().join("cache");
    let paths: [(&str, &Path); 5] = [
        ("--model", &model),
        ("--bags", &bags),
        ("--cache", &cache),
        ("--settings", &settings),
        ("--json", &json),
    ];
    done(&["eval", "all", "--skip", "cost", "robustness"], &paths);
    let found: Value = serde_json::from_str(&fs::read_to_string(json).unwrap()).unwrap();
    let figure = |name: &str| found["metrics"][name]["value"].as_f64().unwrap();
    let ratio = figure("control.ratio_k1");
    assert!(ratio < 0.9, "{ratio}");
    assert!(figure("control.ratio_k1_negated") > ratio);
    assert!(figure("fidelity.psnr_ceiling") > figure("fidelity.psnr"));
    assert!(figure("latents.idm_k1_r_real") > 0.0);
}

#[test]
fn invalid_evaluations_are_rejected_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let all = ["eval", "all", "--model"];
    let error = refused(
        &[&all[..], &["no/such"]].concat(),
        &[("--bags", &path("bags"))],
    );
    assert!(error.contains("no/such"), "{error}");
    let error = refused(
        &[&all[..], &["tiny"]].concat(),
        &[("--bags", &path("bags"))],
    );
    assert!(error.contains("bags"), "{error}");
    fs::write(path("s.yaml"), "control: {populaton: 1}").unwrap();
    let bags = path("bags");
    done(
        &["sim", "--episodes", "1", "--frames", "30"],
        &[("--out", &bags)],
    );
    let settings = path("s.yaml");
    let paths: [(&str, &Path); 3] = [
        ("--bags", &bags),
        ("--cache", &path("cache")),
        ("--settings", &settings),
    ];
    let error = refused(&[&all[..], &["tiny"]].concat(), &paths);
    assert!(
        error.contains("s.yaml") && error.contains("populaton"),
        "{error}"
    );
    // Faults are found before measuring.
    let settings = path("ok.yaml");
    fs::write(&settings, SMALL).unwrap();
    let on: [(&str, &Path); 3] = [
        ("--bags", &bags),
        ("--cache", &path("cache")),
        ("--settings", &settings),
    ];
    let json = path("f.json");
    for (more, told) in [
        (vec!["--compare", "tiny"], "nothing to compare"),
        (vec!["--compare", "nowhere"], "nowhere: no such folder"),
        (vec!["--sampling-steps", "0"], "--sampling-steps"),
        (vec!["--about", "no.yaml", "--card", "c.md"], "no.yaml"),
        (vec!["--csv", "no/such/f.csv"], "the folder does not exist"),
    ] {
        let paths = [&on[..], &[("--json", json.as_path())]].concat();
        let words = [&all[..], &["tiny"], &more[..]].concat();
        let error = refused(&words, &paths);
        assert!(error.contains(told), "{error}");
        assert!(!path("f.records").exists(), "{more:?}");
    }
    // With one episode there is no other episode's action; an interrupted run continues beside the file.
    let words = ["eval", "control", "--model", "tiny"];
    done(&words, &[&on[..], &[("--json", json.as_path())]].concat());
    let found: Value = serde_json::from_str(&fs::read_to_string(&json).unwrap()).unwrap();
    assert!(found["metrics"]["control.ratio_k1_negated"].is_object());
    assert!(found["metrics"]["control.ratio_k1_shuffled"].is_null());
    assert!(path("f.records").is_dir());
    let error = refused(
        &["dataset", "latents", "--encoder", "tiny"],
        &[("--", &bags)],
    );
    assert!(error.contains("not a prepared data set"), "{error}");

    fs::write(path("r.jsonl"), "{}\n").unwrap();
    let error = refused(&["eval", "merge"], &[("--", &path("r.jsonl"))]);
    assert!(error.contains("r.jsonl: the first line"), "{error}");
}
