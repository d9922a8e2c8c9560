//! `wm eval paper`, of one suite.

use std::fs;

use clap::Parser;
use wm_evaluation::PaperArgs;

use super::bench::Bench;

#[derive(Parser)]
struct Paper {
    #[command(flatten)]
    arguments: PaperArgs,
}

#[test]
fn the_page_is_filled_and_a_run_continues_from_its_records() {
    let bench = Bench::new();
    let out = bench.path("out");
    let run = |more: &[&str]| {
        let path = |name: &str| bench.path(name).display().to_string();
        let (bags, cache, settings) = (path("bags"), path("cache"), path("settings.yaml"));
        let out = out.display().to_string();
        let line = [
            "paper",
            "--model",
            "tiny",
            "--bags",
            &bags,
            "--cache",
            &cache,
            "--settings",
            &settings,
            "--out",
            &out,
            "--skip",
            "control",
            "latents",
            "policy",
            "robustness",
            "cost",
        ];
        Paper::parse_from(line.iter().chain(more)).arguments.run()
    };
    run(&[]).unwrap();
    let page = fs::read_to_string(out.join("paper.md")).unwrap();
    let rows: Vec<&str> = page
        .lines()
        .filter(|line| line.contains("`psnr`"))
        .collect();
    let [row] = rows[..] else {
        panic!("{page}");
    };
    assert!(
        row.contains("(3) | 16.97 to 17.43 | 17.42 to 18.26 |"),
        "{row}"
    );
    for expected in [
        "| LPIPS | `wm eval fidelity`, `lpips` | no network for \\`lpips\\`",
        "| `wm eval control`, `cem_k1_error` | the suite did not run",
        "| `fidelity.steps` | 18 | 45 |",
    ] {
        assert!(page.contains(expected), "{expected}\n{page}");
    }
    // As the paper, whatever the protocol.
    assert!(!page.contains("`control.searched`"), "{page}");

    let error = run(&[]).unwrap_err().to_string();
    assert!(error.contains("exists already"), "{error}");
    let report = fs::read(out.join("figures.json")).unwrap();
    for name in ["paper.md", "report.html", "figures.json", "figures.csv"] {
        fs::remove_file(out.join(name)).unwrap();
    }
    let records = out.join("records");
    let record = fs::read_dir(&records)
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    let measured = fs::read(&record).unwrap();
    run(&[]).unwrap();
    assert_eq!(fs::read(&record).unwrap(), measured, "measured again");
    assert_eq!(fs::read(out.join("figures.json")).unwrap(), report);
    assert_eq!(fs::read_to_string(out.join("paper.md")).unwrap(), page);

    let error = run(&["--report", "elsewhere"]).unwrap_err().to_string();
    assert!(error.contains("--report"), "{error}");
}
