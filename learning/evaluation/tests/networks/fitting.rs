//! Files that differ from `networks.yaml`, and networks that do not suit their role.

use wm_evaluation::onnx::{Digest, Error, Pooling, Role, Size};

use super::pictures::{networks, picture};

const PLAIN: &str = "flow: { file: flow.onnx, input: { resize: none, range: [0, 1] } }";

#[test]
fn digest_of_the_file_is_verified() {
    let found = networks(PLAIN).open(Role::Flow).unwrap();
    let digest = Digest::of(include_bytes!("../../fixtures/flow.onnx"));
    assert_eq!(found.digest(), digest);
    assert!(found.file().ends_with("fixtures/flow.onnx"));
    let stated = |digest: String| {
        let text = format!(
            "flow: {{ file: flow.onnx, sha256: \"{digest}\", input: {{ resize: none, range: [0, 1] }} }}"
        );
        networks(&text).flow()
    };
    assert!(stated(digest.to_string()).is_ok());
    let error = stated("0".repeat(64)).unwrap_err();
    assert!(matches!(error, Error::Digest { .. }));
    assert!(error.to_string().contains(&digest.to_string()), "{error}");
}

#[test]
fn unsuitable_networks_are_named() {
    let one = |role: &str, file: &str, rest: &str| {
        networks(&format!(
            "{role}:\n  file: {file}.onnx\n  input: {{ resize: none, range: [0, 1] }}\n  {rest}"
        ))
    };
    let pictures = [picture((32, 32), 0, (0, 0))];
    let features = one("fid", "transformer", "").features(Role::Fid).unwrap();
    assert_eq!(features.network().spec().pooling, Pooling::None);
    assert_eq!(features.network().spec().input.size, None::<Size>);
    for (error, parts) in [
        (
            features.of(&pictures).unwrap_err(),
            &["output", "`pooling`", "[1, 17, 16]"][..],
        ),
        (
            one("fid", "flow", "").features(Role::Fid).unwrap_err(),
            &["inputs", "expected 1", "found 2"],
        ),
        (
            one("flow", "depth", "").flow().unwrap_err(),
            &["inputs", "expected 2", "found 1"],
        ),
        (
            one("fid", "transformer", "output: 1")
                .features(Role::Fid)
                .unwrap_err(),
            &["output", "tokens", "`1`"],
        ),
        (
            one("fid", "transformer", "output: x")
                .features(Role::Fid)
                .unwrap_err(),
            &["output", "tokens", "`x`"],
        ),
        (
            one("tracks", "flow", "").tracks().unwrap_err(),
            &["visibility", "`1`"],
        ),
        (
            one("fid", "transformer", "")
                .clip_features(Role::Fid)
                .unwrap_err(),
            &["features of clips"],
        ),
        (
            one("fid", "transformer", "").scores(Role::Fid).unwrap_err(),
            &["scores"],
        ),
    ] {
        let error = error.to_string();
        for part in parts {
            assert!(error.contains(part), "no {part:?} in {error:?}");
        }
    }
}
