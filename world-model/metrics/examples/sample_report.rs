//! Writes reports of made-up findings, to check the layout.
//!
//! `cargo run -p wm_metrics --example sample_report -- FOLDER` writes `one.html`, `three.html`, `one.json`, `three.json`,
//! `three.csv` and `MODEL.md`.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::indexing_slicing,
    missing_docs
)]

#[path = "../tests/findings/sample.rs"]
mod sample;

use std::{env, fs, path::PathBuf};

use sample::{TITLE, about, findings};

fn main() {
    let folder = PathBuf::from(env::args().nth(1).expect("expected the folder to write to"));
    fs::create_dir_all(&folder).unwrap();
    let one = [findings("sample-a", 0)];
    let three = [
        findings("sample-a", 0),
        findings("sample-b", 1),
        findings("sample-<script>", 2),
    ];
    let write = |name: &str, text: String| fs::write(folder.join(name), text).unwrap();
    write("one.html", wm_metrics::findings::html(TITLE, &one).unwrap());
    write(
        "three.html",
        wm_metrics::findings::html(TITLE, &three).unwrap(),
    );
    write("one.json", wm_metrics::findings::json(&one).unwrap());
    write("three.json", wm_metrics::findings::json(&three).unwrap());
    write("three.csv", wm_metrics::findings::csv(&three));
    write(
        "MODEL.md",
        wm_metrics::findings::model_card(&one[0], &about()),
    );
}
