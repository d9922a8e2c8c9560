//! Parquet tables with LeRobot's kinds of columns.

mod writer;

use std::{fs::File, ops::Range, path::Path, path::PathBuf, sync::Arc};

use parquet::{
    errors::ParquetError,
    file::reader::{FileReader as _, SerializedFileReader},
    record::Field,
    schema::types::Type,
};

use crate::lerobot::LeRobotError;
pub(crate) use writer::{Column, TableWriter};

pub(crate) struct Table {
    path: PathBuf,
    reader: SerializedFileReader<File>,
}

impl Table {
    pub fn open(path: &Path) -> Result<Self, LeRobotError> {
        let file = File::open(path).map_err(|source| LeRobotError::io(path, source))?;
        let reader = SerializedFileReader::new(file).map_err(|error| {
            LeRobotError::corrupt(path, format!("not a parquet table: {error}"))
        })?;
        Ok(Self {
            path: path.to_owned(),
            reader,
        })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn row_count(&self) -> u64 {
        let groups = self.reader.metadata().row_groups();
        groups
            .iter()
            .map(|group| u64::try_from(group.num_rows()).unwrap_or(0))
            .sum()
    }

    /// The columns' names.
    pub fn columns(&self) -> impl Iterator<Item = &str> {
        self.fields().iter().map(|field| field.name())
    }

    pub fn has(&self, column: &str) -> bool {
        self.columns().any(|name| name == column)
    }

    /// The first column of texts, as pandas stores an unnamed text index.
    pub fn text_column(&self) -> Option<&str> {
        let is_text = |field: &&Arc<Type>| {
            field.is_primitive() && field.get_physical_type() == parquet::basic::Type::BYTE_ARRAY
        };
        self.fields().iter().find(is_text).map(|field| field.name())
    }

    fn fields(&self) -> &[Arc<Type>] {
        self.reader.metadata().file_metadata().schema().get_fields()
    }

    /// Passes the cells of these columns in a range of rows to `each`, row by row. Reads only the row groups of the range.
    ///
    /// # Errors
    /// A column is missing, the range is past the end, the table is damaged, or `each` fails; all name the file.
    pub fn rows(
        &self,
        columns: &[&str],
        range: Range<u64>,
        mut each: impl FnMut(u64, &[Field]) -> Result<(), String>,
    ) -> Result<(), LeRobotError> {
        let corrupt = |reason: String| LeRobotError::corrupt(&self.path, reason);
        let damaged = |error: ParquetError| corrupt(error.to_string());
        if range.end > self.row_count() {
            return Err(corrupt(format!(
                "expected rows {} to {}, but it has {}",
                range.start,
                range.end,
                self.row_count()
            )));
        }
        let mut fields = Vec::new();
        for column in columns {
            let field = self.fields().iter().find(|field| field.name() == *column);
            let field = field.ok_or_else(|| {
                let there: Vec<&str> = self.columns().collect();
                corrupt(format!(
                    "expected a column {column:?}, but it has {}",
                    there.join(", ")
                ))
            })?;
            fields.push(Arc::clone(field));
        }
        let schema = self.reader.metadata().file_metadata().schema();
        let projection = Type::group_type_builder(schema.name())
            .with_fields(fields)
            .build()
            .map_err(damaged)?;
        let mut first = 0u64;
        for number in 0..self.reader.num_row_groups() {
            let group = self.reader.get_row_group(number).map_err(damaged)?;
            let rows = u64::try_from(group.metadata().num_rows()).unwrap_or(0);
            let (begin, end) = (first, first.saturating_add(rows));
            first = end;
            if end <= range.start || begin >= range.end {
                continue;
            }
            let read = group
                .get_row_iter(Some(projection.clone()))
                .map_err(damaged)?;
            for (row, cells) in (begin..).zip(read) {
                let cells = cells.map_err(damaged)?;
                if row < range.start {
                    continue;
                }
                if row >= range.end {
                    break;
                }
                // The projection keeps the file's order.
                let mut found: Vec<(String, Field)> = cells.into_columns();
                let mut ordered = Vec::with_capacity(columns.len());
                for column in columns {
                    let at = found.iter().position(|(name, _)| name == column);
                    let at = at.ok_or_else(|| corrupt(format!("row {row} has no {column:?}")))?;
                    ordered.push(found.swap_remove(at).1);
                }
                each(row, &ordered).map_err(|reason| corrupt(format!("row {row}: {reason}")))?;
            }
        }
        Ok(())
    }
}

pub(crate) fn integer(name: &str, cell: Option<&Field>) -> Result<i64, String> {
    match cell {
        Some(Field::Long(value)) => Ok(*value),
        Some(Field::Int(value)) => Ok(i64::from(*value)),
        // LeRobot's `tolist` of NumPy scalars may write floats.
        Some(Field::ListInternal(list)) if list.len() == 1 => {
            integer(name, list.elements().first())
        }
        other => Err(format!(
            "{name}: expected a whole number, got {}",
            describe(other)
        )),
    }
}

/// A finite number.
pub(crate) fn number(name: &str, cell: Option<&Field>) -> Result<f64, String> {
    let value = match cell {
        Some(Field::Float(value)) => f64::from(*value),
        Some(Field::Double(value)) => *value,
        Some(Field::Float16(value)) => f64::from(value.to_f32()),
        Some(Field::Long(value)) => *value as f64,
        Some(Field::Int(value)) => f64::from(*value),
        Some(Field::ListInternal(list)) if list.len() == 1 => {
            return number(name, list.elements().first());
        }
        other => {
            return Err(format!(
                "{name}: expected a number, got {}",
                describe(other)
            ));
        }
    };
    if value.is_finite() {
        Ok(value)
    } else {
        Err(format!("{name}: expected a finite number, got {value}"))
    }
}

/// `width` finite numbers; nested lists are read row by row.
pub(crate) fn numbers(name: &str, cell: Option<&Field>, width: usize) -> Result<Vec<f64>, String> {
    fn collect(name: &str, cell: &Field, values: &mut Vec<f64>) -> Result<(), String> {
        if let Field::ListInternal(list) = cell {
            return list
                .elements()
                .iter()
                .try_for_each(|element| collect(name, element, values));
        }
        values.push(number(name, Some(cell))?);
        Ok(())
    }
    let mut values = Vec::with_capacity(width.min(64));
    if let Some(cell) = cell {
        collect(name, cell, &mut values)?;
    }
    if values.len() == width {
        Ok(values)
    } else {
        Err(format!(
            "{name}: expected {width} values, got {}",
            values.len()
        ))
    }
}

/// A boolean, also if stored as a number.
pub(crate) fn boolean(name: &str, cell: Option<&Field>) -> Result<bool, String> {
    match cell {
        Some(Field::Bool(value)) => Ok(*value),
        Some(Field::ListInternal(list)) if list.len() == 1 => {
            boolean(name, list.elements().first())
        }
        other => number(name, other).map(|value| value != 0.0),
    }
}

pub(crate) fn text(name: &str, cell: Option<&Field>) -> Result<String, String> {
    match cell {
        Some(Field::Str(text)) => Ok(text.clone()),
        Some(Field::Bytes(bytes)) => String::from_utf8(bytes.data().to_vec())
            .map_err(|error| format!("{name}: expected a text: {error}")),
        other => Err(format!("{name}: expected a text, got {}", describe(other))),
    }
}

/// A picture in a cell.
#[derive(Debug, PartialEq)]
pub(crate) enum Picture {
    /// Bytes of the file.
    Bytes(Vec<u8>),
    /// Path of the file.
    Path(String),
}

/// The picture of a cell: a group with `bytes` and `path` (images of the Python package `datasets`), or one of these.
pub(crate) fn picture(name: &str, cell: Option<&Field>) -> Result<Picture, String> {
    let mut path = None;
    match cell {
        Some(Field::Bytes(bytes)) => return Ok(Picture::Bytes(bytes.data().to_vec())),
        Some(Field::Str(text)) => path = Some(text),
        Some(Field::Group(row)) => {
            for (part, value) in row.get_column_iter() {
                match (part.as_str(), value) {
                    ("bytes", Field::Bytes(bytes)) => {
                        return Ok(Picture::Bytes(bytes.data().to_vec()));
                    }
                    ("path", Field::Str(text)) => path = Some(text),
                    _ => {}
                }
            }
        }
        _ => {}
    }
    let path = path.filter(|path| !path.is_empty());
    path.map(|path| Picture::Path(path.clone())).ok_or_else(|| {
        format!(
            "{name}: expected an image's bytes or path, got {}",
            describe(cell)
        )
    })
}

fn describe(cell: Option<&Field>) -> String {
    match cell {
        None => "nothing".to_owned(),
        Some(Field::ListInternal(list)) => format!("a list of {}", list.len()),
        Some(Field::Group(_)) => "a group".to_owned(),
        Some(other) => other.to_string(),
    }
}

#[cfg(test)]
mod tests;
