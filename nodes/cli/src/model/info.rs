//! `wm model info`.

mod folder;

use crate::output::print;
use anyhow::{Context as _, Result};
use clap::Args;
use folder::Folder;
use serde_json::{Map, json};
use std::fmt::Write as _;
use wm_zoo::cost::Row;

/// Lists the parts of a model folder, or counts the parameters and operations of the paper's systems.
#[derive(Args, Debug)]
pub(crate) struct InfoCommand {
    /// A model: `tiny`, or a folder; or a system of the paper, by the name of its row; without one, all of these
    #[arg(value_name = "MODEL")]
    name: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl InfoCommand {
    pub(crate) fn run(self) -> Result<()> {
        let is_model = |name: &&String| !Row::NAMES.contains(&name.as_str());
        if let Some(name) = self.name.as_ref().filter(is_model) {
            let folder = Folder::open(name).with_context(|| {
                let rows = Row::NAMES.join(", ");
                format!("`{name}` is not a row of the table ({rows}), and as a model")
            })?;
            return match self.json {
                true => print(format_args!("{:#}\n", folder.json())),
                false => print(folder),
            };
        }
        let names = match &self.name {
            Some(name) => vec![name.as_str()],
            None => Row::NAMES.to_vec(),
        };
        let rows = names
            .into_iter()
            .map(Row::count)
            .collect::<wm_zoo::Result<Vec<_>>>()?;
        if self.json {
            let mut by_name = Map::new();
            for row in rows {
                by_name.insert(row.name.to_owned(), serde_json::to_value(row.figures())?);
            }
            let rows = json!({ "rows": by_name });
            print(format_args!("{}\n", serde_json::to_string_pretty(&rows)?))
        } else {
            print(table(&rows)?)
        }
    }
}

/// The table as text.
fn table(rows: &[Row]) -> Result<String> {
    let mut text = String::new();
    let part = "parameters [M]";
    let operations = "GFLOPs for one 256x256 frame (multiply-add = 2)";
    writeln!(text, "{:<16}{part:<36}{operations}", "")?;
    let columns = [
        "encoder", "adapter", "DiT-L", "decoder", "encoder", "adapter", "DiT-L", "decoder", "total",
    ];
    writeln!(text, "{:<16}{}", "", cells(columns.map(str::to_owned)))?;
    for row in rows {
        let f = row.figures();
        let figures = [
            Some(f.enc_params_m),
            f.adapter_params_m,
            Some(f.dit_params_m),
            Some(f.dec_params_m),
            Some(f.enc_gflops),
            f.adapter_gflops,
            Some(f.dit_gflops),
            Some(f.dec_gflops),
            Some(f.total_gflops),
        ];
        let figures = figures.map(|figure| match figure {
            Some(figure) => format!("{figure:.1}"),
            None => "-".to_owned(),
        });
        writeln!(text, "{:<16}{}", row.name, cells(figures))?;
    }
    Ok(text)
}

/// Cells of equal width.
fn cells(texts: [String; 9]) -> String {
    texts.map(|text| format!("{text:>8}")).join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn row_has_all_its_figures() {
        let text = table(&[Row::count("cosmos-ci16x16").unwrap()]).unwrap();
        let last = text.lines().last().unwrap();
        let words: Vec<&str> = last.split_whitespace().collect();
        let expected = [
            "cosmos-ci16x16",
            "33.5",
            "-",
            "910.0",
            "48.0",
            "47.6",
            "-",
            "316.5",
            "101.7",
            "465.8",
        ];
        assert_eq!(words, expected);
        assert!(text.lines().all(|line| line == line.trim_end()), "{text}");
    }
}
