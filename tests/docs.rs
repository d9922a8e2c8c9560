//! The documentation: its links lead somewhere, the commands that are marked as runnable run, and it agrees with the program
//! and the repository.

mod code;
mod program;
mod sources;

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use pulldown_cmark::{CodeBlockKind, Event, Options, Parser, Tag, TagEnd};

use crate::harness::{WM, fresh_domain, in_domain, root, whole_suite};

/// Marks the next command block as runnable: it needs only this repository, and ends by itself.
const MARK: &str = "<!-- runnable -->";

/// Pages in folders without foreign pages.
fn pages() -> Vec<PathBuf> {
    let folders = [
        ".",
        "docs",
        "launch-configs",
        "bags/tabletop",
        "fuzz",
        "examples/cloned_policy",
        "examples/imagined_policy",
        "world-model/model/weights",
    ];
    let mut pages = Vec::new();
    for folder in folders {
        for entry in fs::read_dir(root().join(folder)).expect("a folder of the repository") {
            let path = entry.expect("an entry").path();
            if path.extension().is_some_and(|extension| extension == "md") {
                pages.push(path);
            }
        }
    }
    pages
}

fn parser(text: &str) -> Parser<'_> {
    Parser::new_ext(text, Options::ENABLE_TABLES)
}

/// The anchors of a page's headings, as in GitHub and mdBook.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut anchors = BTreeSet::new();
    let mut heading: Option<String> = None;
    for event in parser(text) {
        match event {
            Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
            Event::End(TagEnd::Heading(_)) => {
                let words = heading.take().unwrap_or_default().to_lowercase();
                let kept = |c: &char| c.is_alphanumeric() || matches!(c, '-' | '_' | ' ');
                let slug = words
                    .chars()
                    .filter(kept)
                    .map(|c| if c == ' ' { '-' } else { c });
                anchors.insert(slug.collect());
            }
            Event::Text(part) | Event::Code(part) => {
                if let Some(heading) = &mut heading {
                    heading.push_str(&part);
                }
            }
            _ => {}
        }
    }
    anchors
}

/// The targets of a page's links and pictures.
fn targets(text: &str) -> Vec<String> {
    let target = |event| match event {
        Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
            Some(dest_url.into_string())
        }
        _ => None,
    };
    parser(text).filter_map(target).collect()
}

#[test]
fn links_lead_to_files_and_headings() {
    let mut broken = Vec::new();
    let mut checked = 0;
    for page in pages() {
        let text = fs::read_to_string(&page).expect("a page");
        for target in targets(&text) {
            if target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            checked += 1;
            let (path, anchor) = target.split_once('#').unwrap_or((&target, ""));
            let file = match path {
                "" => page.clone(),
                path => page.parent().expect("a folder").join(path),
            };
            let is_there = match anchor {
                "" => file.exists(),
                anchor => {
                    fs::read_to_string(&file).is_ok_and(|text| anchors(&text).contains(anchor))
                }
            };
            if !is_there {
                broken.push(format!("{}: {target}", page.display()));
            }
        }
    }
    assert!(checked > 100, "only {checked} links were found");
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn every_page_is_in_the_book() {
    let summary = fs::read_to_string(root().join("docs/SUMMARY.md")).expect("the summary");
    let listed: BTreeSet<String> = targets(&summary).into_iter().collect();
    for page in pages() {
        let name = page
            .file_name()
            .expect("a name")
            .to_string_lossy()
            .into_owned();
        if page.starts_with(root().join("docs")) && name != "SUMMARY.md" {
            assert!(listed.contains(&name), "docs/SUMMARY.md lacks {name}");
        }
    }
}

/// The command blocks of a page that are marked as runnable.
fn runnable(text: &str) -> Vec<String> {
    let mut blocks = Vec::new();
    let (mut is_marked, mut block) = (false, None);
    for event in parser(text) {
        match event {
            Event::Html(html) if html.trim() == MARK => is_marked = true,
            Event::Start(Tag::CodeBlock(CodeBlockKind::Indented | CodeBlockKind::Fenced(_)))
                if is_marked =>
            {
                block = Some(String::new());
            }
            Event::Text(part) => {
                if let Some(block) = &mut block {
                    block.push_str(&part);
                }
            }
            Event::End(TagEnd::CodeBlock) => {
                blocks.extend(block.take());
                is_marked = false;
            }
            Event::Start(Tag::Paragraph | Tag::Heading { .. }) => {
                assert!(!is_marked, "{MARK} without a command block after it");
            }
            _ => {}
        }
    }
    blocks
}

/// The exit code of commands that finished but lost data.
const DATA_LOSS: i32 = 3;

/// Runs a block in a folder like the repository, as a user would after a build.
fn run(block: &str, folder: &Path) {
    let path = std::env::var("PATH").expect("a PATH");
    let own = Path::new(WM).parent().expect("a folder");
    // only the build command is replaced
    let build = "cargo() { [ \"$1 $2 $3\" = 'run --release --' ] && shift 3 && wm \"$@\"; }";
    let mut command = Command::new("bash");
    command
        .args(["-euo", "pipefail", "-c", &format!("{build}\n{block}")])
        .current_dir(folder)
        .env("PATH", format!("{}:{path}", own.display()))
        .env("HOME", folder);
    in_domain(&mut command, fresh_domain());
    let mut run = command.output().expect("bash runs");
    // On a busy machine, a message to the recorder may be lost in transport. A message that the recorder itself drops or
    // cannot decode is a fault.
    if run.status.code() == Some(DATA_LOSS) {
        let printed = String::from_utf8_lossy(&run.stdout);
        let losses: Vec<&str> = printed
            .lines()
            .filter(|line| line.contains("] lost "))
            .collect();
        let is_transport = |line: &&str| {
            line.contains("missing in their publishers' sequence numbers")
                && !line.contains("full queue")
                && !line.contains("undecodable")
        };
        assert!(
            !losses.is_empty() && losses.iter().all(is_transport),
            "{losses:?}"
        );
        eprintln!("once more: {}", losses.join("; "));
        run = command.output().expect("bash runs");
    }
    assert!(
        run.status.success(),
        "{}\n{block}\n{}{}",
        run.status,
        String::from_utf8_lossy(&run.stdout),
        String::from_utf8_lossy(&run.stderr)
    );
}

#[test]
fn runnable_commands_run() {
    let _alone = whole_suite();
    let folder = tempfile::tempdir().expect("a temporary directory");
    for shared in ["bags", "launch-configs", "examples"] {
        std::os::unix::fs::symlink(root().join(shared), folder.path().join(shared))
            .expect("a link");
    }
    let mut count = 0;
    for page in pages() {
        for block in runnable(&fs::read_to_string(&page).expect("a page")) {
            eprintln!("{}:\n{block}", page.display());
            run(&block, folder.path());
            count += 1;
        }
    }
    assert!(count >= 5, "only {count} blocks are marked");
}

#[test]
fn only_marked_blocks_are_found() {
    let text = format!(
        "Text.\n\n    first\n\nMore.\n\n{MARK}\n\n    second\n    third\n\nEnd.\n\n    fourth\n"
    );
    assert_eq!(runnable(&text), ["second\nthird\n"]);
}

#[test]
fn anchors_match_github() {
    let text = "# A plain one\n\n## `wm eval`: does it, or not?\n";
    let expected = ["a-plain-one", "wm-eval-does-it-or-not"].map(str::to_owned);
    assert_eq!(anchors(text), expected.into());
}
