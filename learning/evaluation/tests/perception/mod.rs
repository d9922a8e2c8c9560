//! `wm eval fidelity` with networks and `wm eval paper`: the embedded model on bags of the simulator.

mod bench;
mod lpips;
#[cfg(feature = "onnx")]
mod onnx;
mod paper;

use std::fs;

use clap::Parser as _;
use wm_metrics::findings::Suite;

use bench::{Bench, Eval, METRICS, alexnet, value, why};

#[test]
fn missing_networks_are_named_and_lpips_reads_torch_files() {
    let bench = Bench::new();
    let figures = bench.figures("none.json", &[]);
    for name in METRICS {
        let why = why(&figures, name);
        assert!(
            why.contains("no network for") && why.contains("docs/evaluation.md"),
            "{why}"
        );
    }
    assert!(value(&figures, "psnr") > 0.0);
    assert!(figures["settings"]["networks"].is_null());

    let folder = alexnet();
    let figures = bench.figures("lpips.json", &[("--lpips", &folder)]);
    let (predicted, ceiling) = (value(&figures, "lpips"), value(&figures, "lpips_ceiling"));
    assert!(
        0.0 < ceiling && ceiling < predicted,
        "{ceiling} {predicted}"
    );
    assert!((value(&figures, "lpips_gap") - (predicted - ceiling)).abs() < 1e-12);
    assert_eq!(figures["metrics"]["fidelity.lpips"]["n"], 3);
    let lacking = why(&figures, "t_lpips");
    assert!(
        lacking.contains("`flow`") && !lacking.contains("`lpips`"),
        "{lacking}"
    );
    let digests = &figures["settings"]["networks"]["lpips"];
    assert_eq!(digests["heads"].as_str().unwrap().len(), 64, "{digests}");

    let error = bench.eval(&[("--lpips", bench.dir.path())]).unwrap_err();
    assert!(
        format!("{error:#}").contains("expected alexnet"),
        "{error:#}"
    );
}

#[test]
fn unusable_file_is_rejected_by_name() {
    let bench = Bench::new();
    let file = bench.path("networks.yaml");
    let refused = |text: &str| {
        fs::write(&file, text).unwrap();
        format!("{:#}", bench.eval(&[("--networks", &file)]).unwrap_err())
    };
    let error = refused("lpisp: {file: a.onnx}");
    assert!(
        error.contains("networks.yaml") && error.contains("lpisp"),
        "{error}"
    );
    let error = refused("fid: {file: no.onnx, input: {resize: none, range: [0, 1]}}");
    assert!(error.contains("no.onnx"), "{error}");
    let missing = bench.path("no.yaml");
    let error = bench.eval(&[("--networks", &missing)]).unwrap_err();
    assert!(format!("{error:#}").contains("no.yaml"), "{error:#}");

    let arguments = Eval::parse_from([
        "eval",
        "--model",
        "tiny",
        "--bags",
        "bags",
        "--networks",
        "networks.yaml",
    ]);
    let error = arguments.arguments.run(&[Suite::Control]).unwrap_err();
    assert!(
        error.to_string().contains("only to the suite fidelity"),
        "{error}"
    );
}

#[cfg(not(feature = "onnx"))]
#[test]
fn build_without_onnx_names_the_feature() {
    let bench = Bench::new();
    let file = bench.path("networks.yaml");
    let network = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/score.onnx");
    let text = format!(
        "musiq: {{file: {}, input: {{resize: none, range: [0, 1]}}, score_range: [0, 100]}}",
        network.display()
    );
    fs::write(&file, text).unwrap();
    let error = format!("{:#}", bench.eval(&[("--networks", &file)]).unwrap_err());
    assert!(
        error.contains("--features onnx") && error.contains("score.onnx"),
        "{error}"
    );
}
