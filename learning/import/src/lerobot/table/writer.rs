use std::{fs, fs::File, path::Path, path::PathBuf, sync::Arc};

use parquet::{
    basic::{Compression, ConvertedType, LogicalType, Repetition, Type as PhysicalType},
    data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type},
    errors::ParquetError,
    file::{metadata::KeyValue, properties::WriterProperties, writer::SerializedFileWriter},
    schema::types::{Type, TypePtr},
};

use crate::lerobot::LeRobotError;

/// The cells of a column, by row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Column {
    Integers(Vec<i64>),
    Floats(Vec<f32>),
    Doubles(Vec<f64>),
    Booleans(Vec<bool>),
    Texts(Vec<String>),
    /// Lists of `width` numbers.
    FloatRows {
        width: usize,
        values: Vec<f32>,
    },
    /// Lists of numbers, nested `depth` deep, with one element in all but the outermost: `[r, g, b]` at depth 1,
    /// `[[[r]], [[g]], [[b]]]` at depth 3.
    DoubleLists {
        depth: usize,
        rows: Vec<Vec<f64>>,
    },
    IntegerLists(Vec<Vec<i64>>),
    TextLists(Vec<Vec<String>>),
}

impl Column {
    fn shape(&self) -> (PhysicalType, usize) {
        match self {
            Self::Integers(_) => (PhysicalType::INT64, 0),
            Self::Floats(_) => (PhysicalType::FLOAT, 0),
            Self::Doubles(_) => (PhysicalType::DOUBLE, 0),
            Self::Booleans(_) => (PhysicalType::BOOLEAN, 0),
            Self::Texts(_) => (PhysicalType::BYTE_ARRAY, 0),
            Self::FloatRows { .. } => (PhysicalType::FLOAT, 1),
            Self::DoubleLists { depth, .. } => (PhysicalType::DOUBLE, *depth),
            Self::IntegerLists(_) => (PhysicalType::INT64, 1),
            Self::TextLists(_) => (PhysicalType::BYTE_ARRAY, 1),
        }
    }

    /// The column in a schema, with lists in three levels (parquet's LogicalTypes.md).
    fn field(&self, name: &str) -> Result<TypePtr, ParquetError> {
        let (physical, depth) = self.shape();
        let leaf = if depth == 0 { name } else { "element" };
        let mut leaf =
            Type::primitive_type_builder(leaf, physical).with_repetition(Repetition::REQUIRED);
        if physical == PhysicalType::BYTE_ARRAY {
            leaf = leaf
                .with_logical_type(Some(LogicalType::String))
                .with_converted_type(ConvertedType::UTF8);
        }
        let mut field = Arc::new(leaf.build()?);
        for level in (0..depth).rev() {
            let repeated = Type::group_type_builder("list")
                .with_repetition(Repetition::REPEATED)
                .with_fields(vec![field])
                .build()?;
            field = Arc::new(
                Type::group_type_builder(if level == 0 { name } else { "element" })
                    .with_repetition(Repetition::REQUIRED)
                    .with_logical_type(Some(LogicalType::List))
                    .with_converted_type(ConvertedType::LIST)
                    .with_fields(vec![Arc::new(repeated)])
                    .build()?,
            );
        }
        Ok(field)
    }
}

/// Values in order, with the levels at which lists begin (Dremel, as in parquet's format).
struct Levels<T> {
    values: Vec<T>,
    definitions: Vec<i16>,
    repetitions: Vec<i16>,
}

impl<T> Levels<T> {
    fn of<'a, U: 'a>(
        rows: impl Iterator<Item = &'a [U]>,
        depth: i16,
        value: impl Fn(&U) -> T,
    ) -> Self {
        let mut levels = Self {
            values: Vec::new(),
            definitions: Vec::new(),
            repetitions: Vec::new(),
        };
        for row in rows {
            if row.is_empty() {
                levels.definitions.push(0);
                levels.repetitions.push(0);
            }
            for (number, cell) in row.iter().enumerate() {
                levels.values.push(value(cell));
                levels.definitions.push(depth);
                levels.repetitions.push(i16::from(number > 0));
            }
        }
        levels
    }
}

/// Writes a table; each batch of rows becomes a row group, as LeRobot makes one per episode.
pub(crate) struct TableWriter {
    path: PathBuf,
    writer: SerializedFileWriter<File>,
}

impl TableWriter {
    /// Creates a table with the columns of a first batch.
    pub fn create(
        path: &Path,
        columns: &[(String, Column)],
        metadata: &[(&str, String)],
    ) -> Result<Self, LeRobotError> {
        if let Some(dir) = path.parent() {
            fs::create_dir_all(dir).map_err(|source| LeRobotError::io(dir, source))?;
        }
        let file = File::create_new(path).map_err(|source| LeRobotError::io(path, source))?;
        let begin = || {
            let fields = columns.iter().map(|(name, column)| column.field(name));
            let schema = Type::group_type_builder("schema")
                .with_fields(fields.collect::<Result<_, _>>()?)
                .build()?;
            let metadata = metadata
                .iter()
                .map(|(key, value)| KeyValue::new((*key).to_owned(), value.clone()));
            // Snappy, as in LeRobot.
            let properties = WriterProperties::builder()
                .set_compression(Compression::SNAPPY)
                .set_key_value_metadata(Some(metadata.collect()))
                .build();
            SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties))
        };
        Ok(Self {
            path: path.to_owned(),
            writer: begin().map_err(|error| LeRobotError::corrupt(path, error.to_string()))?,
        })
    }

    /// Size of the file \[bytes\].
    pub fn bytes(&self) -> u64 {
        self.writer.bytes_written() as u64
    }

    /// Adds rows with the columns of the first batch, in the same order.
    pub fn write(&mut self, columns: &[(String, Column)]) -> Result<(), LeRobotError> {
        self.try_write(columns)
            .map_err(|error| LeRobotError::corrupt(&self.path, error.to_string()))
    }

    fn try_write(&mut self, columns: &[(String, Column)]) -> Result<(), ParquetError> {
        let mut group = self.writer.next_row_group()?;
        for (_, column) in columns {
            let mut writer = group
                .next_column()?
                .ok_or_else(|| ParquetError::General("more columns than in the schema".into()))?;
            match column {
                Column::Integers(values) => write_flat::<Int64Type>(&mut writer, values)?,
                Column::Floats(values) => write_flat::<FloatType>(&mut writer, values)?,
                Column::Doubles(values) => write_flat::<DoubleType>(&mut writer, values)?,
                Column::Booleans(values) => write_flat::<BoolType>(&mut writer, values)?,
                Column::Texts(texts) => {
                    let texts: Vec<ByteArray> = texts.iter().map(|text| byte_array(text)).collect();
                    write_flat::<ByteArrayType>(&mut writer, &texts)?;
                }
                Column::FloatRows { width, values } => {
                    let rows = values.chunks((*width).max(1));
                    write_lists::<FloatType>(&mut writer, Levels::of(rows, 1, |value| *value))?;
                }
                Column::DoubleLists { depth, rows } => {
                    // Fits: depths are 1 or 3.
                    let depth = *depth as i16;
                    let rows = rows.iter().map(Vec::as_slice);
                    write_lists::<DoubleType>(
                        &mut writer,
                        Levels::of(rows, depth, |value| *value),
                    )?;
                }
                Column::IntegerLists(rows) => {
                    let rows = rows.iter().map(Vec::as_slice);
                    write_lists::<Int64Type>(&mut writer, Levels::of(rows, 1, |value| *value))?;
                }
                Column::TextLists(rows) => {
                    let rows = rows.iter().map(Vec::as_slice);
                    write_lists::<ByteArrayType>(
                        &mut writer,
                        Levels::of(rows, 1, |text: &String| byte_array(text)),
                    )?;
                }
            }
            writer.close()?;
        }
        group.close()?;
        Ok(())
    }

    /// Closes the table.
    pub fn finish(self) -> Result<(), LeRobotError> {
        let ended = self.writer.close();
        ended.map_err(|error| LeRobotError::corrupt(&self.path, error.to_string()))?;
        Ok(())
    }
}

type ColumnWriter<'a> = parquet::file::writer::SerializedColumnWriter<'a>;

fn write_flat<T: DataType>(writer: &mut ColumnWriter, values: &[T::T]) -> Result<(), ParquetError> {
    writer.typed::<T>().write_batch(values, None, None)?;
    Ok(())
}

fn write_lists<T: DataType>(
    writer: &mut ColumnWriter,
    levels: Levels<T::T>,
) -> Result<(), ParquetError> {
    let (definitions, repetitions) = (Some(&*levels.definitions), Some(&*levels.repetitions));
    writer
        .typed::<T>()
        .write_batch(&levels.values, definitions, repetitions)?;
    Ok(())
}

fn byte_array(text: &str) -> ByteArray {
    ByteArray::from(text)
}
