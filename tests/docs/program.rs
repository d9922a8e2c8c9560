//! Nodes, topics, parameters, commands and flags of the documentation, compared with what `wm` prints.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
    process::Command,
};

use super::{
    code::{code, rows, spans},
    pages,
};
use crate::harness::{WM, root};

/// Standard output of `wm` with `args`; `None` if it fails, as without the program behind the command.
fn printed(args: &[&str]) -> Option<String> {
    let mut command = Command::new(WM);
    let run = command.args(args).current_dir(root()).output();
    let run = run.expect("wm runs");
    run.status
        .success()
        .then(|| String::from_utf8_lossy(&run.stdout).into_owned())
}

/// The pages of the documentation with their code. The changelog names what earlier versions had.
fn pages_with_code() -> Vec<(String, Vec<String>)> {
    let current = |page: &Path| !page.ends_with("CHANGELOG.md");
    let pages = pages().into_iter().filter(|page| current(page));
    pages
        .map(|page| {
            let text = fs::read_to_string(&page).expect("a page");
            (page.display().to_string(), code(&text))
        })
        .collect()
}

fn nodes() -> Vec<String> {
    let printed = printed(&["nodes"]).expect("the nodes");
    let first = |line: &str| line.split_whitespace().next().map(str::to_owned);
    printed.lines().filter_map(first).collect()
}

/// Topics, services and actions of the nodes, absolute as in the namespace `/wm`.
fn topics() -> BTreeSet<String> {
    let printed = printed(&["nodes", "--topics"]).expect("the topics");
    let mut topics = BTreeSet::new();
    for row in printed.lines().filter(|line| line.contains('`')) {
        let node = row.trim_start_matches('|').split('|').next();
        let (node, name) = (node.expect("a node").trim(), spans(row)[0]);
        topics.insert(match name.strip_prefix("~/") {
            Some(name) => format!("/wm/{node}/{name}"),
            None if name.starts_with('/') => name.to_owned(),
            None => format!("/wm/{name}"),
        });
    }
    assert!(topics.len() > 50, "only {} topics", topics.len());
    topics
}

#[test]
fn readme_lists_every_node() {
    let readme = fs::read_to_string(root().join("README.md")).expect("the README");
    let rows = rows(&readme, "## Nodes and topics", "## Limits");
    let listed: BTreeSet<&str> = rows.iter().flat_map(|row| spans(row[0])).collect();
    let nodes = nodes();
    let nodes: BTreeSet<&str> = nodes.iter().map(String::as_str).collect();
    let missing: Vec<_> = nodes.difference(&listed).collect();
    let unknown: Vec<_> = listed.difference(&nodes).collect();
    assert!(
        missing.is_empty() && unknown.is_empty(),
        "README.md, Nodes and topics: lacks {missing:?}, has unknown {unknown:?}"
    );
}

#[test]
fn topics_page_lists_every_topic_and_service() {
    let page = fs::read_to_string(root().join("docs/topics.md")).expect("the page");
    let listed: BTreeSet<String> = code(&page).into_iter().collect();
    let is_listed = |topic: &String| {
        let raw = topic.strip_suffix("/compressed");
        listed.contains(topic) || raw.is_some_and(|raw| listed.contains(raw))
    };
    let topics = topics();
    let missing: Vec<_> = topics.iter().filter(|topic| !is_listed(topic)).collect();
    assert!(missing.is_empty(), "docs/topics.md lacks {missing:?}");
}

/// Names below `/wm/` in code. One that ends with `/` is the beginning of others.
fn names_below_wm(code: &str) -> Vec<&str> {
    let is_of_name = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '/';
    let found = code.match_indices("/wm/").filter(|(at, _)| {
        let before = code[..*at].chars().next_back();
        !before.is_some_and(|c| is_of_name(c) || matches!(c, '.' | ':'))
    });
    found
        .map(|(at, _)| code[at..].split(|c| !is_of_name(c)).next().unwrap_or(""))
        .collect()
}

#[test]
fn topics_in_the_documentation_exist() {
    let topics = topics();
    let nodes: BTreeSet<String> = nodes().iter().map(|node| format!("/wm/{node}")).collect();
    let exists = |name: &str| match name.strip_suffix('/') {
        Some(_) => topics.iter().any(|topic| topic.starts_with(name)),
        None => topics.contains(name) || nodes.contains(name),
    };
    let (mut unknown, mut count) = (Vec::new(), 0);
    for (page, code) in pages_with_code() {
        for name in code.iter().flat_map(|code| names_below_wm(code)) {
            count += 1;
            if !exists(name) {
                unknown.push(format!("{page}: no node has {name}"));
            }
        }
    }
    assert!(count > 100, "only {count} names were found");
    assert!(unknown.is_empty(), "{}", unknown.join("\n"));
}

/// Parameters of all nodes, and arguments of all launch files.
fn parameters() -> BTreeSet<String> {
    let mut names = BTreeSet::from(["use_sim_time".to_owned()]);
    for node in nodes() {
        let file = printed(&[&node, "--print-params"]).expect("a parameter file");
        // Without a default it is a comment.
        let entries = file.lines().filter_map(|line| line.strip_prefix("    "));
        let entries = entries.map(|entry| entry.trim_start_matches("# "));
        names.extend(entries.filter_map(|entry| Some(entry.split_once(':')?.0.to_owned())));
    }
    for entry in fs::read_dir(root().join("launch-configs")).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path
            .extension()
            .is_some_and(|extension| extension == "yaml")
        {
            let text = fs::read_to_string(path).expect("a launch file");
            let entries = text
                .lines()
                .filter_map(|line| line.strip_prefix("    name: "));
            names.extend(entries.map(str::to_owned));
        }
    }
    names
}

/// Names that get a value by `NAME:=VALUE` in code, other than remaps of topics.
fn assigned(code: &str) -> Vec<&str> {
    let is_of_name = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    let found = code.match_indices(":=").filter_map(|(at, _)| {
        let rest = code[..at].trim_end_matches(is_of_name);
        let name = &code[rest.len()..at];
        let is_remap = rest.ends_with("-r ") || rest.ends_with("--remap ");
        let is_whole = rest.is_empty() || rest.ends_with([' ', '(']);
        (is_whole && !is_remap && !name.starts_with('_')).then_some(name)
    });
    found.collect()
}

#[test]
fn parameters_in_the_documentation_exist() {
    let known = parameters();
    let (mut unknown, mut count) = (Vec::new(), 0);
    for (page, code) in pages_with_code() {
        for name in code.iter().flat_map(|code| assigned(code)) {
            count += 1;
            if !known.contains(name) {
                unknown.push(format!("{page}: no parameter {name}"));
            }
        }
    }
    assert!(count > 80, "only {count} parameters were found");
    assert!(unknown.is_empty(), "{}", unknown.join("\n"));
}

/// The help of commands, each asked for once.
#[derive(Default)]
struct Help(RefCell<BTreeMap<Vec<String>, Option<String>>>);

impl Help {
    /// `None` if the program behind the command is not built.
    fn of(&self, command: &[String]) -> Option<String> {
        let mut known = self.0.borrow_mut();
        let entry = known.entry(command.to_owned()).or_insert_with(|| {
            let mut args: Vec<&str> = command.iter().map(String::as_str).collect();
            args.push("--help");
            let help = printed(&args);
            if help.is_none() {
                eprintln!("skipped: wm {} is not built", command.join(" "));
            }
            help
        });
        entry.clone()
    }
}

/// The commands that a help text lists.
fn commands(help: &str) -> BTreeSet<&str> {
    let lines = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    let lines = lines.take_while(|line| line.is_empty() || line.starts_with(' '));
    let entries = lines.filter_map(|line| line.strip_prefix("  "));
    let entries = entries.filter(|entry| entry.starts_with(|c: char| c.is_ascii_lowercase()));
    entries
        .filter_map(|entry| entry.split_whitespace().next())
        .collect()
}

fn has_flag(help: &str, flag: &str) -> bool {
    let is_longer = |rest: &str| rest.starts_with(|c: char| c.is_ascii_alphanumeric() || c == '-');
    let mut found = help.match_indices(flag);
    found.any(|(at, _)| !is_longer(&help[at + flag.len()..]))
}

/// The calls of `wm` in a line, each without the word `wm`.
fn calls(line: &str) -> Vec<Vec<&str>> {
    let line = line.split(" #").next().unwrap_or("");
    let mut calls = Vec::new();
    let separators = ["&&", ";", " & ", " | "];
    let mut parts = vec![line];
    for separator in separators {
        parts = parts
            .iter()
            .flat_map(|part| part.split(separator))
            .collect();
    }
    for part in parts {
        let words: Vec<&str> = part.split_whitespace().collect();
        match words.as_slice() {
            ["wm", call @ ..] | ["cargo", "run", "--release", "--", call @ ..] => {
                calls.push(call.to_vec());
            }
            _ => {}
        }
    }
    calls
}

/// Checks a call of `wm`, and returns the number of its commands and flags that exist.
///
/// # Errors
/// The first word that `wm` does not know.
fn check(call: &[&str], help: &Help) -> Result<usize, String> {
    let (mut path, mut words, mut count) = (Vec::new(), call, 0);
    let page = loop {
        let Some(page) = help.of(&path) else {
            return Ok(count);
        };
        let known = commands(&page);
        let Some((word, rest)) = words.split_first() else {
            break page;
        };
        if known.is_empty() || word.starts_with('-') {
            break page;
        }
        // A path: `wm dataset` takes bags as well as commands.
        if word.contains('/') {
            break page;
        }
        // A placeholder, whose flags are not known.
        if !word.starts_with(|c: char| c.is_ascii_lowercase()) {
            return Ok(count);
        }
        for word in word.split('|') {
            if !known.contains(word) {
                return Err(format!("no command {word} of wm {}", path.join(" ")));
            }
            count += 1;
        }
        path.push(word.split('|').next().unwrap_or(word).to_owned());
        words = rest;
    };
    // The suite `control` has flags of its own for tasks on the simulated arm.
    let task = (path == ["eval", "control"])
        .then(|| help.of(&["eval".to_owned(), "task".to_owned()]))
        .flatten()
        .unwrap_or_default();
    let parent = help
        .of(&path[..path.len().saturating_sub(1)])
        .unwrap_or_default();
    for word in words.iter().take_while(|word| **word != "--ros-args") {
        let word = word.trim_start_matches('[');
        if !word.starts_with("--") || word == "--" {
            continue;
        }
        let is_of_flag = |c: char| c.is_ascii_alphanumeric() || c == '-';
        let flag = word.split(|c| !is_of_flag(c)).next().unwrap_or(word);
        if ![&page, &task, &parent]
            .iter()
            .any(|help| has_flag(help, flag))
        {
            return Err(format!("no flag {flag} of wm {}", path.join(" ")));
        }
        count += 1;
    }
    Ok(count)
}

#[test]
fn commands_and_flags_in_the_documentation_exist() {
    let help = Help::default();
    let (mut unknown, mut count) = (Vec::new(), 0);
    for (page, code) in pages_with_code() {
        for line in &code {
            for call in calls(line) {
                match check(&call, &help) {
                    Ok(found) => count += found,
                    Err(fault) => unknown.push(format!("{page}: {fault}: {line}")),
                }
            }
        }
    }
    assert!(count > 150, "only {count} commands and flags were found");
    assert!(unknown.is_empty(), "{}", unknown.join("\n"));
}

#[test]
fn unknown_commands_flags_and_names_are_found() {
    let help = Help::default();
    assert!(check(&["bag", "information"], &help).is_err());
    assert!(check(&["bag", "info", "--audits"], &help).is_err());
    assert_eq!(check(&["bag", "info|cut", "BAG", "[--audit"], &help), Ok(4));
    assert_eq!(check(&["NODE", "--print-params"], &help), Ok(0));
    let line = "A=1 b && wm x --y   # wm z";
    assert_eq!(calls(line), [["x", "--y"]]);
    assert_eq!(
        names_below_wm("~/.cache/wm/a -r /wm/b_c:=/d /wm/e/... '/wm/.*'"),
        ["/wm/b_c", "/wm/e/", "/wm/"]
    );
    let line = "wm x a:=1 -p b_2:=c -r d:=/e -r f/g:=h __ns:=/i";
    assert_eq!(assigned(line), ["a", "b_2"]);
    assert!(has_flag("  --audit <X>", "--audit") && !has_flag("  --audits", "--audit"));
}
