//! Where findings go.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, bail, ensure};
use clap::Args;
use wm_findings::{Better, CardAbout, ModelFindings};

use crate::card::{self, Written};

/// Where findings go.
#[derive(Clone, Debug, Default, Args)]
pub struct OutputArgs {
    /// File for the figures as JSON.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// File for the figures as CSV, a row for each.
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Folder for the report: report.html, figures.json, figures.csv, and the records.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// File for the model card of the first model, as MODEL.md. One that somebody changed is not replaced.
    #[arg(long, value_name = "FILE")]
    pub card: Option<PathBuf>,
    /// YAML with what a card tells besides figures: name, data, recipe, limits, uses_refused, commands.
    #[arg(long, value_name = "FILE", requires = "card")]
    pub about: Option<PathBuf>,
}

impl OutputArgs {
    /// Writes the files, and prints the figures.
    ///
    /// # Errors
    /// If a file cannot be written, or the findings cannot be compared.
    pub fn write(&self, findings: &[ModelFindings]) -> Result<()> {
        let json = wm_findings::json(findings)?;
        let csv = wm_findings::csv(findings);
        let mut files = vec![(self.json.clone(), &json), (self.csv.clone(), &csv)];
        let html;
        if let Some(folder) = &self.report {
            fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
            html = wm_findings::html(&title(findings), findings)?;
            files.push((Some(folder.join("figures.json")), &json));
            files.push((Some(folder.join("figures.csv")), &csv));
            files.push((Some(folder.join("report.html")), &html));
        }
        for model in findings {
            print(model);
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
        let about = match &self.about {
            Some(file) => card::about(file)?,
            None => CardAbout {
                name: findings.header.model.clone(),
                ..CardAbout::default()
            },
        };
        match card::write(path, findings, &about)? {
            Written::Yes => println!("wrote {}", path.display()),
            Written::Kept => bail!(
                "{}: it was changed by hand, and stays; give another name",
                path.display()
            ),
        }
        Ok(())
    }

    /// Refuses files that are there.
    ///
    /// # Errors
    /// Names the first.
    pub fn require_free(&self) -> Result<()> {
        let report = self.report.iter().map(|folder| folder.join("report.html"));
        let files = self.json.iter().chain(&self.csv).cloned();
        for path in files.chain(report) {
            ensure!(
                !path.exists(),
                "{}: it is there already; give another name or remove it",
                path.display()
            );
        }
        Ok(())
    }
}

fn title(findings: &[ModelFindings]) -> String {
    let models = findings.iter().map(|found| &*found.header.model);
    format!("Evaluation of {}", models.collect::<Vec<_>>().join(", "))
}

/// Nothing of the user's is replaced.
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
