//! What `networks.yaml` may say, and what it is told when it may not.

use wm_evaluation::onnx::{Error, Layout, Networks, Output, Role, Size};

const EXAMPLE: &str = include_str!("../../networks.example.yaml");

fn parse(text: &str) -> Result<Networks, String> {
    Networks::parse(text, "some/networks.yaml").map_err(|error| error.to_string())
}

fn with(role: &str, rest: &str) -> String {
    format!("{role}:\n  file: a.onnx\n  {rest}\n")
}

const PLAIN: &str = "input: { resize: none, range: [0, 1] }";

#[test]
fn the_example_has_every_role() {
    let networks = parse(EXAMPLE).unwrap();
    assert_eq!(networks.absent().count(), 0);
    assert_eq!(networks.present().collect::<Vec<_>>(), Role::ALL);
    let fvd = networks.spec(Role::Fvd).unwrap();
    assert_eq!(
        (fvd.input.frames, fvd.input.size),
        (Some(16), Some(Size::Exact([128, 171])))
    );
    let subject = networks.spec(Role::Subject).unwrap();
    assert_eq!(subject.output, Output::Name("last_hidden_state".to_owned()));
    assert_eq!(
        networks.spec(Role::Aesthetic).unwrap().score_range,
        Some([0.0, 10.0])
    );
    assert_eq!(
        networks.spec(Role::Tracks).unwrap().input.layout,
        Some(Layout::Ntchw)
    );
}

#[test]
fn nothing_is_no_network() {
    for text in ["", "# none yet\n", "fid:\n"] {
        assert_eq!(
            parse(text).unwrap().absent().count(),
            Role::ALL.len(),
            "{text:?}"
        );
    }
    let error = Networks::none("networks.yaml").open(Role::Fid).unwrap_err();
    assert!(matches!(error, Error::MissingNetwork { .. }));
    assert_eq!(
        error.to_string(),
        "FID: not measured: no network for `fid`; add one to networks.yaml"
    );
    for role in Role::ALL {
        assert!(role.not_measured().contains(role.name()));
    }
}

#[test]
fn what_is_wrong_is_named() {
    let sized = |rest: &str| format!("input: {{ range: [0, 1], {rest} }}");
    for (text, parts) in [
        (with("fud", PLAIN), &["unknown field `fud`", "`fvd`"][..]),
        (
            with("fid", PLAIN) + &with("fid", PLAIN),
            &["duplicate", "fid"],
        ),
        (
            with("fid", "input: { resize: none, range: [0, 1], sise: 3 }"),
            &["fid", "sise", "`size`"],
        ),
        (
            with("fid", "input: { resize: cubic, range: [0, 1] }"),
            &["cubic", "bicubic"],
        ),
        (with("fid", "input: { resize: none }"), &["range"]),
        (
            with("fid", &sized("resize: none, size: []")),
            &["[height, width]"],
        ),
        (
            with("fid", &sized("resize: bilinear, size: 8")),
            &["fid: input.antialias: is missing"],
        ),
        (
            with("fid", &sized("resize: nearest, size: 8, antialias: true")),
            &["input.antialias"],
        ),
        (
            with("fid", &sized("resize: nearest")),
            &["input.size: is missing"],
        ),
        (
            with("fid", &sized("resize: nearest, size: [8, 0]")),
            &["input.size", "found 0"],
        ),
        (
            with("fid", &sized("resize: nearest, size: 5000")),
            &["input.size", "4096", "5000"],
        ),
        (
            with("fid", &sized("resize: none, std: [1, 0, 1]")),
            &["input.std"],
        ),
        (
            with("fid", &sized("resize: none, mean: [1, .nan, 1]")),
            &["input.mean"],
        ),
        (
            with("fid", "input: { resize: none, range: [1, 1] }"),
            &["input.range"],
        ),
        (
            with("fid", &sized("resize: none, layout: ncthw")),
            &["input.layout", "nchw", "ncthw"],
        ),
        (
            with("fid", &sized("resize: none, frames: 4")),
            &["input.frames", "fid"],
        ),
        (
            with("fvd", &sized("resize: none, frames: 0")),
            &["input.frames", "found 0"],
        ),
        (
            with("flow", &sized("resize: none, crop: [4, 4]")),
            &["input.crop", "whole picture"],
        ),
        (with("musiq", PLAIN), &["musiq: score_range: is missing"]),
        (
            with("musiq", &format!("{PLAIN}\n  score_range: [3, 3]")),
            &["score_range"],
        ),
        (
            with("fid", &format!("{PLAIN}\n  score_range: [0, 1]")),
            &["score_range"],
        ),
        (
            with("fid", &format!("{PLAIN}\n  visibility: 1")),
            &["visibility", "tracks only"],
        ),
        (
            with("fid", &format!("{PLAIN}\n  visible_above: 1")),
            &["visible_above", "tracks only"],
        ),
        (
            with("depth", &format!("{PLAIN}\n  pooling: space")),
            &["pooling", "features only"],
        ),
        (
            with("fid", &format!("{PLAIN}\n  batch: 0")),
            &["batch", "1 to 64"],
        ),
        (
            with("fid", &format!("{PLAIN}\n  output: [1]")),
            &["number of an output"],
        ),
        (
            with("fid", &format!("{PLAIN}\n  sha256: abc")),
            &["64 hexadecimal", "abc"],
        ),
    ] {
        let error = parse(&text).unwrap_err();
        for part in [&["some/networks.yaml"], parts].concat() {
            assert!(error.contains(part), "no {part:?} in {error:?}");
        }
    }
}

#[test]
fn a_file_that_is_not_there() {
    let error = Networks::read("no/such/networks.yaml")
        .unwrap_err()
        .to_string();
    assert!(error.starts_with("no/such/networks.yaml: "), "{error}");
    let error = parse(&with("fid", PLAIN)).unwrap();
    let error = error.open(Role::Fid).unwrap_err().to_string();
    assert!(error.starts_with("some/a.onnx: "), "{error}");
}

#[cfg(not(feature = "onnx"))]
#[test]
fn without_a_runtime_it_says_how_to_build_with_one() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/networks.yaml");
    let networks = Networks::parse(
        &with("fid", PLAIN).replace("a.onnx", "convolutions.onnx"),
        folder,
    )
    .unwrap();
    let error = networks.features(Role::Fid).unwrap_err();
    assert!(matches!(error, Error::NoRuntime { .. }));
    let error = error.to_string();
    assert!(
        error.contains("fid: ") && error.contains("--features onnx"),
        "{error}"
    );
}
