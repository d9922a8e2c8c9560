//! The table of a derived action space.

use std::fmt;

use wm_motion::actions::{Dimension, Kind};

use super::DerivedSpace;

/// A table: name, kind, unit, measured range, range of -1 to 1, reason.
impl fmt::Display for DerivedSpace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let heads = ["name", "kind", "unit", "measured", "-1 to 1 is", "reason"];
        let mut table = vec![heads.map(str::to_owned)];
        for (dimension, value) in self.space.dimensions().iter().zip(&self.values) {
            let measured = (value.spread.least, value.spread.most);
            table.push([
                dimension.name.clone(),
                kind_name(value.kind),
                dimension.unit.clone(),
                format!("{:.4} to {:.4}", measured.0, measured.1),
                scaled(dimension),
                value.reason.clone(),
            ]);
        }
        let plural = if self.episodes == 1 { "" } else { "s" };
        write!(
            f,
            "no --action-space was given; derived from the names and values of {} episode{plural}, at {} Hz:",
            self.episodes,
            self.space.rate()
        )?;
        let width = |column: usize| {
            let cells = table.iter().filter_map(|row| row.get(column));
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..heads.len()).map(width).collect();
        for row in &table {
            let mut line = String::from(" ");
            for (cell, width) in row.iter().zip(&widths) {
                line.push_str(&format!(" {cell:width$} "));
            }
            write!(f, "\n{}", line.trim_end())?;
        }
        Ok(())
    }
}

/// The name of a kind in an action space's file.
fn kind_name(kind: Kind) -> String {
    // Kinds are texts in JSON.
    let value = serde_json::to_value(kind).unwrap_or_default();
    value.as_str().unwrap_or_default().to_owned()
}

/// The range that maps to -1 to 1.
fn scaled(dimension: &Dimension) -> String {
    let (offset, range) = (dimension.offset, dimension.scale.recip());
    match dimension.kind {
        Kind::GripperBinary => "0 closed, 1 open".to_owned(),
        Kind::GripperContinuous => format!("{offset:.4} closed, {:.4} open", offset + range),
        _ => format!("{:.4} to {:.4}", offset - range, offset + range),
    }
}
