//! A Parquet file: columns by name and type, rows in groups.

use std::path::PathBuf;
use std::sync::Arc;

use ::parquet::basic::{Compression, ZstdLevel};
use ::parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use ::parquet::errors::ParquetError;
use ::parquet::file::metadata::KeyValue;
use ::parquet::file::properties::{EnabledStatistics, WriterProperties};
use ::parquet::file::writer::SerializedFileWriter;
use ::parquet::schema::parser::parse_message_type;
use outfile::OutFile;

use crate::failure::Failure;

/// Type of a column.
#[derive(Debug, Clone, Copy)]
pub(super) enum Kind {
    /// Integers.
    Whole,
    /// Instants: us since 1970-01-01 UTC, integers.
    Time,
    /// Numbers, may be null.
    Real,
    /// Text, may be null.
    Text,
}

/// The values of a column in a group of rows.
#[derive(Debug, Clone)]
pub(super) enum Column {
    Whole(Vec<i64>),
    Real(Vec<Option<f64>>),
    Text(Vec<Option<String>>),
}

pub(super) struct Table {
    writer: SerializedFileWriter<OutFile>,
}

impl Table {
    /// `facts`: names and values of metadata; empty values are left out.
    pub(super) fn new(
        file: OutFile,
        columns: &[(String, Kind)],
        facts: &[(&str, &str)],
    ) -> Result<Self, Failure> {
        let lines: String = columns
            .iter()
            .map(|(name, kind)| {
                let form = match kind {
                    Kind::Whole => format!("required int64 {name};"),
                    Kind::Time => format!("required int64 {name} (TIMESTAMP(MICROS,true));"),
                    Kind::Real => format!("optional double {name};"),
                    Kind::Text => format!("optional binary {name} (STRING);"),
                };
                form + "\n"
            })
            .collect();
        let schema =
            parse_message_type(&format!("message tactus {{\n{lines}}}")).map_err(failed)?;
        let known = facts.iter().filter(|(_, value)| !value.is_empty());
        let facts =
            known.map(|(name, value)| KeyValue::new((*name).to_owned(), (*value).to_owned()));
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .set_key_value_metadata(Some(facts.collect()))
            // both would be kept in memory until the end of the file, for each column of each group: 0.3 kB a frame
            .set_statistics_enabled(EnabledStatistics::None)
            .set_offset_index_disabled(true)
            .build();
        let writer = SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties));
        Ok(Self {
            writer: writer.map_err(failed)?,
        })
    }

    /// Adds a row group: a value for each row and column. An empty group is left out.
    pub(super) fn put(&mut self, columns: &[Column]) -> Result<(), Failure> {
        if columns.first().is_none_or(Column::is_empty) {
            return Ok(());
        }
        self.group(columns).map_err(failed)
    }

    fn group(&mut self, columns: &[Column]) -> Result<(), ParquetError> {
        let mut group = self.writer.next_row_group()?;
        for column in columns {
            let Some(mut writer) = group.next_column()? else {
                return Err(ParquetError::General("more columns than named".to_owned()));
            };
            match column {
                Column::Whole(values) => {
                    writer
                        .typed::<Int64Type>()
                        .write_batch(values, None, None)?;
                }
                Column::Real(values) => {
                    let there: Vec<f64> = values.iter().copied().flatten().collect();
                    writer.typed::<DoubleType>().write_batch(
                        &there,
                        Some(&levels(values)),
                        None,
                    )?;
                }
                Column::Text(values) => {
                    let texts = values.iter().flatten();
                    let there: Vec<ByteArray> = texts.map(|text| text.as_str().into()).collect();
                    writer.typed::<ByteArrayType>().write_batch(
                        &there,
                        Some(&levels(values)),
                        None,
                    )?;
                }
            }
            writer.close()?;
        }
        group.close()?;
        Ok(())
    }

    /// Writes the end of the file and moves it to its path.
    pub(super) fn finish(self) -> Result<PathBuf, Failure> {
        Ok(self.writer.into_inner().map_err(failed)?.finish()?)
    }
}

impl Column {
    fn is_empty(&self) -> bool {
        match self {
            Self::Whole(values) => values.is_empty(),
            Self::Real(values) => values.is_empty(),
            Self::Text(values) => values.is_empty(),
        }
    }
}

/// Definition levels: 1 for a value, 0 for null.
fn levels<T>(values: &[Option<T>]) -> Vec<i16> {
    values
        .iter()
        .map(|value| i16::from(value.is_some()))
        .collect()
}

fn failed(error: ParquetError) -> Failure {
    Failure::failed("the Parquet file cannot be written", &error)
}
