//! Outputs of findings.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, bail, ensure};
use clap::Args;
use wm_metrics::findings::{
    Better, CardDetails, Comparison, ModelFindings, Verdict, compare_with_first, paper_page,
};

use crate::{
    Protocol, Settings,
    card::{self, WriteOutcome},
    families::{self, FamilyArg},
    merge::RECORDS,
};

/// Outputs of findings.
#[derive(Clone, Debug, Default, Args)]
pub struct OutputArgs {
    /// File for the figures as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// File for the figures as CSV, one row each
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Folder for the report: report.html, figures.json and figures.csv
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// File for the quantities of the paper's tables and figures with the values of the models, as Markdown
    #[arg(long, value_name = "FILE")]
    pub paper: Option<PathBuf>,
    /// Families of the models to compare, such as `reconstruction=A,B semantic=C,D`: the mean of each against that of the first,
    /// by unit. Printed, and in the report's folder as families.html and families.json
    #[arg(long, num_args = 2.., value_name = "NAME=MODEL,...")]
    pub families: Vec<FamilyArg>,
    /// File for the model card (MODEL.md) of the first model; an edited card is kept
    #[arg(long, value_name = "FILE")]
    pub card: Option<PathBuf>,
    /// YAML file with the card's other contents: name, data, recipe, limits, uses_refused, commands
    #[arg(long, value_name = "FILE", requires = "card")]
    pub about: Option<PathBuf>,
}

impl OutputArgs {
    /// Writes the files, and prints the figures.
    ///
    /// # Errors
    /// If a file cannot be written, or the findings cannot be compared.
    pub fn write(&self, findings: &[ModelFindings]) -> Result<()> {
        let json = wm_metrics::findings::json(findings)?;
        let csv = wm_metrics::findings::csv(findings);
        let paper = paper(findings)?;
        let mut files = vec![
            (self.json.clone(), &json),
            (self.csv.clone(), &csv),
            (self.paper.clone(), &paper),
        ];
        let families = families::means(&self.families, findings)?;
        let (html, families_json, families_html);
        if let Some(folder) = &self.report {
            fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
            html = wm_metrics::findings::html(&title(findings), findings)?;
            files.push((Some(folder.join("figures.json")), &json));
            files.push((Some(folder.join("figures.csv")), &csv));
            files.push((Some(folder.join("report.html")), &html));
            if !families.is_empty() {
                families_json = wm_metrics::findings::json(&families)?;
                families_html = wm_metrics::findings::html(&title(&families), &families)?;
                files.push((Some(folder.join("families.json")), &families_json));
                files.push((Some(folder.join("families.html")), &families_html));
            }
        }
        for model in findings {
            print(model);
        }
        for compared in [findings, &families] {
            for comparison in compare_with_first(compared)? {
                print_comparison(&comparison);
            }
        }
        for (path, text) in files {
            let Some(path) = path else { continue };
            write(&path, text)?;
            println!("wrote {}", path.display());
        }
        match (&self.card, findings) {
            (Some(path), [first, ..]) => self.write_card(path, first),
            _ => Ok(()),
        }
    }

    fn write_card(&self, path: &Path, findings: &ModelFindings) -> Result<()> {
        let mut about = match &self.about {
            Some(file) => card::about(file)?,
            None => CardDetails {
                name: findings.header.model.clone(),
                ..CardDetails::default()
            },
        };
        if about.commands.is_empty() {
            let words = std::env::args().skip(1);
            about.commands = vec![format!("wm {}", words.collect::<Vec<_>>().join(" "))];
        }
        about.notes.push(card::extent(&findings.header.settings));
        match card::write(path, findings, &about)? {
            WriteOutcome::Yes => println!("wrote {}", path.display()),
            WriteOutcome::Kept => bail!(
                "{}: kept, since it was edited; give another name",
                path.display()
            ),
        }
        Ok(())
    }

    /// Rejects existing files.
    ///
    /// # Errors
    /// Names the first.
    pub fn require_free(&self) -> Result<()> {
        let of_report = ["report.html", "figures.json", "figures.csv"];
        let of_families = ["families.html", "families.json"];
        let of_families = of_families.iter().filter(|_| !self.families.is_empty());
        let of_report: Vec<&str> = of_report.iter().chain(of_families).copied().collect();
        let report = self.report.iter();
        let report = report.flat_map(|folder| of_report.iter().map(|name| folder.join(name)));
        let named = self.json.iter().chain(&self.csv).chain(&self.paper);
        let mut files = BTreeSet::new();
        for path in named.cloned().chain(report) {
            ensure!(
                !path.exists(),
                "{}: exists already; give another name or remove it",
                path.display()
            );
            let shown = path.display().to_string();
            ensure!(files.insert(path), "{shown}: given twice");
        }
        let named = self.json.iter().chain(&self.csv).chain(&self.paper);
        for path in named.chain(&self.card) {
            let folder = path
                .parent()
                .filter(|folder| !folder.as_os_str().is_empty());
            // That of the report will be made.
            ensure!(
                folder
                    .is_none_or(|folder| folder.is_dir() || Some(folder) == self.report.as_deref()),
                "{}: the folder does not exist",
                path.display()
            );
        }
        if let Some(card) = &self.card {
            ensure!(
                card::is_free(card)?,
                "{}: kept, since it was edited; give another name",
                card.display()
            );
        }
        self.about.as_deref().map(card::about).transpose()?;
        Ok(())
    }

    /// Default location of records: in the report, or beside the file of the figures.
    #[must_use]
    pub fn records(&self) -> Option<PathBuf> {
        if let Some(report) = &self.report {
            return Some(report.join(RECORDS));
        }
        let file = self
            .json
            .as_ref()
            .or(self.csv.as_ref())
            .or(self.paper.as_ref())
            .or(self.card.as_ref());
        file.map(|file| file.with_extension(RECORDS))
    }
}

/// The page of the paper's quantities, with the settings that differ from its protocol.
fn paper(findings: &[ModelFindings]) -> Result<String> {
    let seed = findings.first().map_or(0, |first| first.header.seed);
    let protocol = serde_json::to_value(Settings::of(Protocol::Paper, seed))?;
    Ok(paper_page(findings, &protocol))
}

fn title(findings: &[ModelFindings]) -> String {
    let models = findings.iter().map(|found| &*found.header.model);
    format!("Evaluation of {}", models.collect::<Vec<_>>().join(", "))
}

/// Creates a new file; never overwrites.
fn write(path: &Path, text: &str) -> Result<()> {
    use std::io::Write as _;
    let file = fs::File::create_new(path);
    let mut file = file.with_context(|| path.display().to_string())?;
    file.write_all(text.as_bytes())
        .with_context(|| path.display().to_string())
}

fn print(findings: &ModelFindings) {
    let header = &findings.header;
    println!(
        "{} on {} episodes, seed {}",
        header.model, header.episodes, header.seed
    );
    for section in &findings.sections {
        println!("{}: {}", section.suite, section.suite.question());
        for (name, metric) in &section.metrics {
            let interval = metric.interval.map_or(String::new(), |interval| {
                format!(" [{:.3}, {:.3}]", interval.low, interval.high)
            });
            let better = match metric.better {
                Better::Higher => "higher is better",
                Better::Lower => "lower is better",
                Better::Neither => "",
            };
            println!(
                "  {name:<44} {:>9.3}{interval:<18} {} (n = {}) {better}",
                metric.value, metric.unit, metric.n
            );
        }
        for absent in &section.absent {
            println!("  {:<44} not measured: {}", absent.metric, absent.why);
        }
    }
}

/// Prints clear differences, and the number of other figures.
fn print_comparison(comparison: &Comparison) {
    println!(
        "{} compared with {}",
        comparison.model.model, comparison.baseline.model
    );
    let mut others = 0;
    for (name, found) in &comparison.differences {
        if matches!(found.verdict, Verdict::Unclear | Verdict::Untested) {
            others += 1;
            continue;
        }
        let interval = found.interval.map_or(String::new(), |interval| {
            format!(" [{:+.3}, {:+.3}]", interval.low, interval.high)
        });
        let p = found.p.map_or(String::new(), |p| format!(", p = {p:.4}"));
        println!(
            "  {name:<44} {:+9.3}{interval:<20} {}: {} (n = {}{p})",
            found.difference,
            found.unit,
            found.verdict.words(),
            found.n
        );
    }
    println!("  {others} other figures: no clear difference, or too few units");
}
