//! With the small networks of the fixtures.

use std::{
    fs,
    path::{Path, PathBuf},
};

use clap::Parser;
use wm_evaluation::MergeArgs;

use super::bench::{Bench, METRICS, alexnet, value};

#[derive(Parser)]
struct Merge {
    #[command(flatten)]
    arguments: MergeArgs,
}

/// A network of the fixtures for every role.
const ALL: &str = "
lpips: { file: FIXTURES/distance.onnx, input: { resize: bilinear, antialias: true, size: [12, 16], range: [-1, 1] }, batch: 4 }
fid:
  file: FIXTURES/convolutions.onnx
  input: { resize: bilinear, antialias: true, size: [33, 35], range: [0, 1] }
  pooling: space
  batch: 4
fvd: { file: FIXTURES/clip.onnx, input: { resize: bilinear, antialias: false, size: [112, 112], range: [-1, 1] } }
musiq: { file: FIXTURES/score.onnx, input: { resize: bilinear, antialias: true, size: [16, 16], range: [0, 1] }, score_range: [0, 100] }
aesthetic: { file: FIXTURES/score.onnx, input: { resize: bilinear, antialias: true, size: [16, 16], range: [0, 1] }, score_range: [0, 100] }
jepa:
  file: FIXTURES/transformer.onnx
  input: { resize: bicubic, antialias: false, size: [32, 32], range: [0, 1] }
  pooling: tokens
subject:
  file: FIXTURES/transformer.onnx
  input: { resize: bicubic, antialias: false, size: [32, 32], range: [0, 1] }
  output: tokens
  pooling: first_token
background:
  file: FIXTURES/transformer.onnx
  input: { resize: bicubic, antialias: true, size: [32, 32], range: [0, 1] }
  pooling: tokens
flow: { file: FIXTURES/flow.onnx, input: { resize: bilinear, antialias: true, size: [48, 48], range: [0, 1] } }
depth: { file: FIXTURES/depth.onnx, input: { resize: bilinear, antialias: true, size: [16, 24], range: [0, 1] } }
tracks: { file: FIXTURES/tracks.onnx, input: { resize: bilinear, antialias: true, size: [32, 32], range: [0, 255] } }
";

fn networks(bench: &Bench, text: &str) -> PathBuf {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    let file = bench.path("networks.yaml");
    fs::write(
        &file,
        text.replace("FIXTURES", &fixtures.display().to_string()),
    )
    .unwrap();
    file
}

#[test]
fn roles_give_their_metrics_and_shards_equal_the_whole() {
    let bench = Bench::new();
    let file = networks(&bench, ALL);
    let named: [(&str, &Path); 1] = [("--networks", &file)];
    let report = bench.path("report");
    let figures = bench.figures("whole.json", &[named[0], ("--report", &report)]);
    for name in METRICS {
        assert!(value(&figures, name).is_finite(), "{name}");
    }
    assert_eq!(figures["absent"], serde_json::json!({}));
    for name in [
        "lpips",
        "t_lpips",
        "depth_abs_rel",
        "fid",
        "fvd",
        "jepa_mmd",
    ] {
        let (predicted, ceiling) = (
            value(&figures, name),
            value(&figures, &format!("{name}_ceiling")),
        );
        assert!(
            0.0 <= ceiling && ceiling <= predicted,
            "{name}: {ceiling} {predicted}"
        );
        let gap = value(&figures, &format!("{name}_gap"));
        assert!((gap - (predicted - ceiling)).abs() < 1e-9, "{name}: {gap}");
    }
    for name in [
        "image_quality",
        "aesthetic_quality",
        "subject_consistency",
        "background_consistency",
        "dynamic_degree",
        "dynamic_degree_soft",
        "pck_coverage",
        "jepa_similarity",
        "jepa_similarity_ceiling",
    ] {
        let value = value(&figures, name);
        assert!((0.0..=1.0).contains(&value), "{name}: {value}");
    }
    assert!(value(&figures, "flow_mean") <= value(&figures, "flow_score"));
    let metrics = &figures["metrics"];
    assert_eq!(metrics["fidelity.lpips"]["n"], 3);
    assert_eq!(metrics["fidelity.fvd"]["n"], 2);
    assert!(metrics["fidelity.lpips"]["interval"].is_array());
    assert!(metrics["fidelity.fid"]["interval"].is_null());
    let html = fs::read_to_string(report.join("report.html")).unwrap();
    for text in [
        "LPIPS by step",
        "PCK coverage by step",
        "fvd covers 2 of 3 episodes",
    ] {
        assert!(html.contains(text), "{text}");
    }
    let of_networks = &figures["settings"]["networks"];
    assert!(of_networks["file"].as_str().unwrap().contains("antialias"));
    assert_eq!(of_networks["sha256"].as_object().unwrap().len(), 11);

    let records = bench.path("records");
    for shard in ["0/2", "1/2"] {
        let shard = Path::new(shard);
        let own: [(&str, &Path); 2] = [("--records", &records), ("--shard", shard)];
        bench.eval(&[named[0], own[0], own[1]]).unwrap();
    }
    let merged = bench.path("merged.json");
    let merge = Merge::parse_from([Path::new("merge"), Path::new("--json"), &merged, &records]);
    merge.arguments.run().unwrap();
    let read = |path: &Path| fs::read_to_string(path).unwrap();
    assert_eq!(read(&merged), read(&bench.path("whole.json")));

    // Records of other networks are rejected.
    let file = networks(&bench, &ALL.replace("[-1, 1]", "[0, 1]"));
    let own: [(&str, &Path); 2] = [("--networks", &file), ("--records", &records)];
    bench
        .eval(&[own[0], own[1], ("--shard", Path::new("0/2"))])
        .unwrap_err();
    let both: [(&str, &Path); 2] = [("--networks", &file), ("--lpips", &alexnet())];
    let error = bench.eval(&both).unwrap_err().to_string();
    assert!(error.contains("one or the other"), "{error}");
}
