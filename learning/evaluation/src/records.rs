//! Measurements by unit on disk, so that interrupted runs resume and shards merge.
//!
//! A file of JSON lines: the heading, then one line per unit, in the order of completion. Findings always come from
//! sorted records that were read back, so one run, a resumed run and merged shards give equal bytes.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::{self, File, OpenOptions},
    io::{BufRead as _, BufReader, Write as _},
    path::{Path, PathBuf},
    sync::Mutex,
};

use anyhow::{Context as _, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use wm_metrics::findings::{Header, Suite};

use crate::{
    control::WindowControl, cost::ModelCost, fidelity::EpisodeFidelity, policy::ImaginedTrial,
    representation::Representation, robustness::WindowRobustness,
};

/// The first line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Heading {
    /// Data and settings of the evaluation.
    pub header: Header,
    /// Position of the model on the command line; the first one is the baseline.
    #[serde(default)]
    pub position: usize,
    /// Number of units by suite, over all shards.
    pub units: BTreeMap<Suite, usize>,
    /// Unmeasurable suites, with reasons.
    #[serde(default)]
    pub absent: BTreeMap<Suite, String>,
}

impl Heading {
    /// The parts that identify the evaluation, with model and data by their hashes, independent of location.
    fn identity(&self) -> Self {
        let mut own = self.clone();
        own.position = 0;
        own.header.model.clear();
        own.header.data.clear();
        own.header.left_out.clear();
        own
    }
}

/// A unit and its result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// The suite.
    pub suite: Suite,
    /// Index of the unit in the suite.
    pub unit: usize,
    /// The unit's name.
    pub name: String,
    /// Result.
    pub found: UnitResult,
}

/// Result of a unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[expect(missing_docs, reason = "named after the suites")]
pub enum UnitResult {
    Fidelity(EpisodeFidelity),
    Control(WindowControl),
    Latents(Representation),
    Policy(ImaginedTrial),
    Robustness(WindowRobustness),
    Cost(ModelCost),
}

/// A file of records open for writing.
pub struct Records {
    path: PathBuf,
    file: Mutex<File>,
    done: BTreeSet<(Suite, usize)>,
}

impl Records {
    /// Opens or creates `path` with `heading`.
    ///
    /// # Errors
    /// Names the differences if the file belongs to another evaluation.
    pub fn open(path: &Path, heading: &Heading) -> Result<Self> {
        let name = || path.display().to_string();
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        }
        let mut done = BTreeSet::new();
        if path.exists() {
            let (found, records, whole) = read_whole(path)?;
            same(heading, &found).with_context(|| {
                format!("{}: of another evaluation; give another --records", name())
            })?;
            done = records.iter().map(|r| (r.suite, r.unit)).collect();
            // Cuts off the incomplete last line of a killed process.
            let file = OpenOptions::new()
                .write(true)
                .open(path)
                .with_context(name)?;
            file.set_len(whole).with_context(name)?;
        } else {
            let mut file = File::create_new(path).with_context(name)?;
            writeln!(file, "{}", serde_json::to_string(heading)?).with_context(name)?;
        }
        let file = OpenOptions::new()
            .append(true)
            .open(path)
            .with_context(name)?;
        file.try_lock()
            .with_context(|| format!("{}: is another process writing it?", name()))?;
        Ok(Self {
            path: path.to_owned(),
            file: Mutex::new(file),
            done,
        })
    }

    /// Units measured earlier.
    #[must_use]
    pub fn len(&self) -> usize {
        self.done.len()
    }

    /// Whether no unit was measured earlier.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.done.is_empty()
    }

    /// Where they are.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether a unit was measured earlier.
    #[must_use]
    pub fn has(&self, suite: Suite, unit: usize) -> bool {
        self.done.contains(&(suite, unit))
    }

    /// Appends a record.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn keep(&self, record: &Record) -> Result<()> {
        let mut line = serde_json::to_string(record)?;
        line.push('\n');
        let mut file = self.file.lock().map_err(|_| {
            anyhow::anyhow!(
                "{}: another thread failed while writing",
                self.path.display()
            )
        })?;
        // In one call, so that a kill leaves at most one incomplete line.
        file.write_all(line.as_bytes())
            .with_context(|| self.path.display().to_string())
    }
}

/// Reads a file.
///
/// # Errors
/// If it is not a file of records.
pub fn read(path: &Path) -> Result<(Heading, Vec<Record>)> {
    let (heading, records, _) = read_whole(path)?;
    Ok((heading, records))
}

/// [`read`], with the length of its complete lines in bytes.
fn read_whole(path: &Path) -> Result<(Heading, Vec<Record>, u64)> {
    let name = || path.display().to_string();
    let mut lines = BufReader::new(File::open(path).with_context(name)?);
    let mut whole = 0;
    let mut next = || -> Result<Option<String>> {
        let mut line = String::new();
        let bytes = lines.read_line(&mut line).with_context(name)?;
        if !line.ends_with('\n') {
            return Ok(None);
        }
        whole += bytes as u64;
        Ok(Some(line))
    };
    let first = next()?.with_context(|| format!("{}: empty file", name()))?;
    let heading = serde_json::from_str(&first)
        .with_context(|| format!("{}: the first line is not a heading of wm eval", name()))?;
    let mut records = Vec::new();
    while let Some(line) = next()? {
        let number = records.len() + 2;
        let record = serde_json::from_str(&line);
        records.push(record.with_context(|| format!("{}, line {number}", name()))?);
    }
    Ok((heading, records, whole))
}

/// Merges the shards of one model: each unit once, sorted.
///
/// # Errors
/// If the files are of different evaluations, disagree on a unit, or lack units.
pub fn merge(files: Vec<(PathBuf, Heading, Vec<Record>)>) -> Result<(Heading, Vec<Record>)> {
    let names: Vec<String> = (files.iter())
        .map(|(path, ..)| path.display().to_string())
        .collect();
    let mut files = files.into_iter();
    let (first, heading, records) = files.next().context("no records")?;
    let mut merged: BTreeMap<(Suite, usize), Record> = BTreeMap::new();
    let mut add = |path: &Path, records: Vec<Record>| -> Result<()> {
        for record in records {
            let (suite, unit) = (record.suite, record.unit);
            if let Some(other) = merged.get(&(suite, unit))
                && *other != record
                && suite != Suite::Cost
            {
                bail!(
                    "{}: {suite}, unit {unit} differs from that of another file",
                    path.display()
                );
            }
            merged.entry((suite, unit)).or_insert(record);
        }
        Ok(())
    };
    add(&first, records)?;
    for (path, other, records) in files {
        same(&heading, &other)
            .with_context(|| format!("{} and {}", first.display(), path.display()))?;
        add(&path, records)?;
    }
    let units = heading.units.iter();
    let missing = units.filter_map(|(suite, units)| {
        let missing = (0..*units).filter(|unit| !merged.contains_key(&(*suite, *unit)));
        let missing = missing.count();
        (missing > 0).then(|| format!("{suite} {missing} of {units}"))
    });
    let missing: Vec<String> = missing.collect();
    ensure!(
        missing.is_empty(),
        "units are missing ({}) in {}: is a shard missing or unfinished?",
        missing.join(", "),
        names.join(", ")
    );
    Ok((heading, merged.into_values().collect()))
}

/// Rejects different evaluations, and names the differences.
fn same(a: &Heading, b: &Heading) -> Result<()> {
    let (a, b) = (
        serde_json::to_value(a.identity())?,
        serde_json::to_value(b.identity())?,
    );
    let mut differences = Vec::new();
    differ("", &a, &b, &mut differences);
    ensure!(differences.is_empty(), "{}", differences.join("; "));
    Ok(())
}

fn differ(at: &str, a: &serde_json::Value, b: &serde_json::Value, found: &mut Vec<String>) {
    if let (Some(a), Some(b)) = (a.as_object(), b.as_object()) {
        let keys: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
        for key in keys {
            let (a, b) = (a.get(key), b.get(key));
            let null = serde_json::Value::Null;
            let at = if at.is_empty() {
                key.clone()
            } else {
                format!("{at}.{key}")
            };
            differ(&at, a.unwrap_or(&null), b.unwrap_or(&null), found);
        }
    } else if a != b {
        found.push(format!("{at}: {a} here, {b} there"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;

    fn heading(seed: u64) -> Heading {
        Heading {
            position: 0,
            absent: BTreeMap::new(),
            header: Header {
                model: "tiny".into(),
                hash: "00".into(),
                space: "space".into(),
                data: vec!["bags".into()],
                data_digest: "11".into(),
                episodes: 2,
                left_out: Vec::new(),
                readers: BTreeMap::new(),
                seed,
                settings: serde_json::to_value(Settings::of(crate::Protocol::Quick, seed)).unwrap(),
                sampler: serde_json::Value::Null,
                version: "0".into(),
            },
            units: [(Suite::Fidelity, 3)].into(),
        }
    }

    fn record(unit: usize) -> Record {
        let found = EpisodeFidelity {
            steps: Vec::new(),
            strip: None,
            perception: Default::default(),
        };
        Record {
            suite: Suite::Fidelity,
            unit,
            name: format!("episode {unit}"),
            found: UnitResult::Fidelity(found),
        }
    }

    #[test]
    fn incomplete_line_is_measured_again_and_shards_merge() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.jsonl");
        let records = Records::open(&path, &heading(0)).unwrap();
        records.keep(&record(0)).unwrap();
        records.keep(&record(2)).unwrap();
        drop(records);
        let whole = fs::read(&path).unwrap();
        fs::write(&path, &whole[..whole.len() - 5]).unwrap();
        let records = Records::open(&path, &heading(0)).unwrap();
        assert!(records.has(Suite::Fidelity, 0) && !records.has(Suite::Fidelity, 2));
        records.keep(&record(2)).unwrap();
        assert_eq!(fs::read(&path).unwrap(), whole);

        let error = Records::open(&path, &heading(1)).err().unwrap();
        let error = format!("{error:#}");
        assert!(error.contains("header.seed: 1 here, 0 there"), "{error}");

        let other = dir.path().join("b.jsonl");
        Records::open(&other, &heading(0))
            .unwrap()
            .keep(&record(1))
            .unwrap();
        let file = |path: &Path| {
            let (heading, records) = read(path).unwrap();
            (path.to_owned(), heading, records)
        };
        let error = merge(vec![file(&path)]).unwrap_err().to_string();
        assert!(error.contains("missing (fidelity 1 of 3)"), "{error}");
        assert!(error.contains("a.jsonl"), "{error}");
        let (_, merged) = merge(vec![file(&other), file(&path)]).unwrap();
        let units: Vec<usize> = merged.iter().map(|record| record.unit).collect();
        assert_eq!(units, [0, 1, 2]);
    }

    #[test]
    fn identity_does_not_depend_on_paths() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.jsonl");
        drop(Records::open(&path, &heading(0)).unwrap());
        let mut elsewhere = heading(0);
        elsewhere.header.model = "./tiny/".into();
        elsewhere.header.data = vec!["/mnt/bags/".into()];
        drop(Records::open(&path, &elsewhere).unwrap());
        elsewhere.header.data_digest = "22".into();
        assert!(Records::open(&path, &elsewhere).is_err());
    }
}
