//! Figures, tests and files of the documentation, compared with the repository.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use super::{
    code::{code, rows, spans},
    pages,
};
use crate::harness::root;

/// Folders of the repository that the documentation names files of.
const FOLDERS: [&str; 12] = [
    ".ci",
    "bags",
    "benches",
    "docs",
    "examples",
    "fuzz",
    "launch-configs",
    "learning",
    "msgs",
    "nodes",
    "tests",
    "world-model",
];

/// Every text that `pattern` stands for. A word in capitals is a placeholder; one without values stands for nothing.
fn expanded(pattern: &str, values: &BTreeMap<&str, Vec<&str>>) -> Vec<String> {
    let is_capital = |c: char| c.is_ascii_uppercase();
    let Some(from) = pattern.find(is_capital) else {
        return vec![pattern.to_owned()];
    };
    let rest = pattern[from..].trim_start_matches(is_capital);
    let (before, name) = (&pattern[..from], &pattern[from..pattern.len() - rest.len()]);
    let values_of = values.get(name).into_iter().flatten();
    let of_first = values_of.map(|value| format!("{before}{value}{rest}"));
    of_first
        .flat_map(|pattern| expanded(&pattern, values))
        .collect()
}

/// The figures of `wm eval` in the model cards, which it wrote: those with a value and those that were not measured.
fn figures_of_cards() -> BTreeSet<String> {
    let mut figures = BTreeSet::new();
    for model in ["tiny", "semantic"] {
        let path = format!("world-model/model/weights/{model}/MODEL.md");
        let card = fs::read_to_string(root().join(path)).expect("a model card");
        let names = card.lines().flat_map(spans);
        let is_figure = |name: &&str| {
            let suite = name.split_once('.').map(|(suite, _)| suite);
            suite.is_some_and(|suite| SUITES.contains(&suite)) && !name.contains(' ')
        };
        figures.extend(names.filter(is_figure).map(str::to_owned));
    }
    assert!(figures.len() > 100, "only {} figures", figures.len());
    figures
}

const SUITES: [&str; 6] = [
    "fidelity",
    "control",
    "latents",
    "policy",
    "robustness",
    "cost",
];

#[test]
fn evaluation_page_lists_the_figures_of_wm_eval() {
    let page = fs::read_to_string(root().join("docs/evaluation.md")).expect("the page");
    let rows_of_figures = rows(&page, "## The figures", "## The suites");
    let (mut patterns, mut values) = (Vec::new(), BTreeMap::new());
    for row in &rows_of_figures {
        match (spans(row[0]).as_slice(), row.get(1)) {
            ([suite], Some(figures)) => {
                patterns.extend(spans(figures).into_iter().map(|figure| (*suite, figure)));
            }
            (_, Some(of_placeholder)) => {
                values.insert(row[0], spans(of_placeholder));
            }
            _ => {}
        }
    }
    let full = |(suite, pattern): &(&str, &str)| -> Vec<String> {
        let names = expanded(pattern, &values).into_iter();
        names.map(|name| format!("{suite}.{name}")).collect()
    };
    let mut documented: BTreeSet<String> = patterns.iter().flat_map(full).collect();
    let by_networks = rows(&page, "## Networks of yours", "## Ranking policies");
    let by_networks = by_networks.iter().filter_map(|row| row.get(1));
    documented.extend(
        by_networks
            .flat_map(|cell| spans(cell))
            .map(|name| format!("fidelity.{name}")),
    );

    let figures = figures_of_cards();
    let missing: Vec<_> = figures.difference(&documented).collect();
    assert!(missing.is_empty(), "docs/evaluation.md lacks {missing:?}");
    // Cards have no figures of judges and of cost.
    let in_cards = ["fidelity", "control", "latents", "robustness"];
    for pattern in patterns
        .iter()
        .filter(|(suite, _)| in_cards.contains(suite))
    {
        let is_known = full(pattern).iter().any(|name| figures.contains(name));
        assert!(is_known, "no model card has {pattern:?}");
    }
}

/// The Rust files below `folder`.
fn rust_files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let entry = entry.expect("an entry");
        let path = entry.path();
        if entry.file_type().expect("a type").is_dir() {
            if path.file_name().is_some_and(|name| name != "target") {
                rust_files(&path, found);
            }
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn tests_that_conformance_names_exist() {
    let mut files = Vec::new();
    for folder in ["bags", "learning", "msgs", "nodes", "tests", "world-model"] {
        rust_files(&root().join(folder), &mut files);
    }
    let mut names = BTreeSet::new();
    for file in &files {
        names.extend(
            file.file_stem()
                .map(|name| name.to_string_lossy().into_owned()),
        );
        let text = fs::read_to_string(file).expect("a source file");
        for word in ["fn ", "mod "] {
            let after = text.split(word).skip(1);
            let is_of_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
            names.extend(
                after.filter_map(|rest| Some(rest.split(|c| !is_of_name(c)).next()?.to_owned())),
            );
        }
    }
    let page = fs::read_to_string(root().join("docs/conformance.md")).expect("the page");
    let (mut unknown, mut count) = (Vec::new(), 0);
    for row in page.lines().filter(|line| line.starts_with("| ")) {
        let tests = row.trim_end_matches('|').rsplit(" | ").next().unwrap_or("");
        for test in spans(tests) {
            // A crate, or a path, which `files_that_the_documentation_names_exist` checks.
            if test.contains('/') || test.starts_with("wm_") {
                continue;
            }
            for name in test.split("::").filter(|name| !name.is_empty()) {
                count += 1;
                if !names.contains(name) {
                    unknown.push(test);
                }
            }
        }
    }
    assert!(count > 50, "only {count} tests were found");
    assert!(
        unknown.is_empty(),
        "docs/conformance.md: no test {unknown:?}"
    );
}

/// Files and folders of the repository in a line of code. `NODE` stands for the name of any node.
fn files(code: &str) -> Vec<&str> {
    let is_of_path = |c: char| c.is_ascii_alphanumeric() || "._-/".contains(c);
    let words = code.split([' ', '\'', '"', ',', ':', '(', ')']);
    let words = words.map(|word| word.trim_end_matches(['.', '/']));
    let is_file = |word: &&str| {
        let folder = word.split_once('/').map(|(folder, _)| folder);
        folder.is_some_and(|folder| FOLDERS.contains(&folder))
            && word.chars().all(is_of_path)
            && !word.contains("NODE")
    };
    words.filter(is_file).collect()
}

#[test]
fn files_that_the_documentation_names_exist() {
    let (mut missing, mut count) = (Vec::new(), 0);
    // The changelog names files of earlier versions, the pages in these folders files that their commands make.
    let has_files = |page: &PathBuf| {
        let makes_files = ["bags", "examples"].map(|folder| root().join(folder));
        !page.ends_with("CHANGELOG.md") && !makes_files.iter().any(|made| page.starts_with(made))
    };
    for page in pages().into_iter().filter(has_files) {
        let text = fs::read_to_string(&page).expect("a page");
        let here = page.parent().expect("a folder");
        for line in code(&text) {
            for file in files(&line) {
                count += 1;
                if !root().join(file).exists() && !here.join(file).exists() {
                    missing.push(format!("{}: no file {file}", page.display()));
                }
            }
        }
    }
    assert!(count > 80, "only {count} files were found");
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}

#[test]
fn modules_beside_ros2_client_exist() {
    let page = fs::read_to_string(root().join("docs/architecture.md")).expect("the page");
    let (from, to) = ("## ros2-client and cv-convert", "cv-convert converts");
    let mut count = 0;
    for row in rows(&page, from, to) {
        for file in row.get(3).into_iter().flat_map(|cell| spans(cell)) {
            let path = root().join("nodes/ros/src").join(file);
            assert!(path.exists(), "docs/architecture.md: no file {file}");
            count += 1;
        }
    }
    assert!(count > 10, "only {count} modules were found");
}

#[test]
fn paths_of_the_repository_are_files() {
    assert_eq!(
        files("python tests/a.py --x nodes/NODE.rs \"docs/b.md\" out/c bags/*.md"),
        ["tests/a.py", "docs/b.md"]
    );
}

#[test]
fn patterns_stand_for_all_their_values() {
    let values = BTreeMap::from([("K", vec!["1", "4"]), ("A", vec!["xK"]), ("B", vec![])]);
    assert_eq!(expanded("a_bK", &values), ["a_b1", "a_b4"]);
    assert_eq!(expanded("A_K", &values), ["x1_1", "x1_4", "x4_1", "x4_4"]);
    assert!(expanded("B_c", &values).is_empty() && expanded("Z", &values).is_empty());
}
