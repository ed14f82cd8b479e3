//! The header of a netCDF-3 file: dimensions, attributes, variables of a fixed size. The records follow it one by one.
//!
//! `netcdf3` writes the header. Its own writer of records keeps an entry in memory for every record and variable, and
//! fills those that were not written. Months of frames are therefore written here, in the order of the file.

use std::cell::RefCell;
use std::io::{Cursor, Seek, SeekFrom, Write};
use std::rc::Rc;

use netcdf3::error::{InvalidDataSet, WriteError};
use netcdf3::{DataSet, DataType, FileWriter, Version};

use crate::failure::Failure;

/// Offset of the number of records in the file: after `CDF` and the version.
pub(super) const RECORD_COUNT_AT: u64 = 4;

/// Attributes of a variable that are text.
pub(super) type Texts<'a> = &'a [(&'a str, &'a str)];

/// Values of a variable of a fixed size.
enum Values {
    Whole(Vec<i32>),
    Real(Vec<f64>),
}

/// The definition of a file.
pub(super) struct Layout {
    set: DataSet,
    fixed: Vec<(String, Values)>,
    /// Values of the attributes that are lists of small integers.
    flags: Vec<Vec<i8>>,
}

impl Layout {
    /// A file in which a dimension of this name counts the records.
    pub(super) fn new(records: &str) -> Result<Self, Failure> {
        let mut set = DataSet::new();
        set.set_unlimited_dim(records, 0).map_err(invalid)?;
        Ok(Self {
            set,
            fixed: Vec::new(),
            flags: Vec::new(),
        })
    }

    pub(super) fn dimension(&mut self, name: &str, size: usize) -> Result<(), Failure> {
        self.set.add_fixed_dim(name, size).map_err(invalid)
    }

    /// Adds a text about the whole file; an empty one is omitted.
    pub(super) fn text(&mut self, name: &str, text: &str) -> Result<(), Failure> {
        match text.is_empty() {
            true => Ok(()),
            false => self.set.add_global_attr_string(name, text).map_err(invalid),
        }
    }

    pub(super) fn number(&mut self, name: &str, value: f64) -> Result<(), Failure> {
        let added = self.set.add_global_attr_f64(name, vec![value]);
        added.map_err(invalid)
    }

    pub(super) fn whole_numbers(
        &mut self,
        name: &str,
        dimensions: &[&str],
        values: Vec<i32>,
        texts: Texts<'_>,
    ) -> Result<(), Failure> {
        self.variable(name, dimensions, DataType::I32, texts)?;
        self.fixed.push((name.to_owned(), Values::Whole(values)));
        Ok(())
    }

    pub(super) fn numbers(
        &mut self,
        name: &str,
        dimensions: &[&str],
        values: Vec<f64>,
        texts: Texts<'_>,
    ) -> Result<(), Failure> {
        self.variable(name, dimensions, DataType::F64, texts)?;
        self.fixed.push((name.to_owned(), Values::Real(values)));
        Ok(())
    }

    /// Adds a variable. If its first dimension counts records, its values are in the records, in the order of
    /// definition.
    pub(super) fn variable(
        &mut self,
        name: &str,
        dimensions: &[&str],
        kind: DataType,
        texts: Texts<'_>,
    ) -> Result<(), Failure> {
        self.set.add_var(name, dimensions, kind).map_err(invalid)?;
        for (attribute, text) in texts {
            let added = self.set.add_var_attr_string(name, attribute, text);
            added.map_err(invalid)?;
        }
        Ok(())
    }

    /// Adds an attribute that is a list of small integers to a variable.
    pub(super) fn flags(
        &mut self,
        variable: &str,
        name: &str,
        values: &[i8],
    ) -> Result<(), Failure> {
        self.flags.push(values.to_vec());
        let added = self.set.add_var_attr_i8(variable, name, values.to_vec());
        added.map_err(invalid)
    }

    /// Adds an attribute that is an integer to a variable.
    pub(super) fn count(&mut self, variable: &str, name: &str, value: i32) -> Result<(), Failure> {
        let added = self.set.add_var_attr_i32(variable, name, vec![value]);
        added.map_err(invalid)
    }

    /// The bytes before the records, with a count of 0 records.
    pub(super) fn bytes(&self) -> Result<Vec<u8>, Failure> {
        let sink = Shared::default();
        let unwritten = |error: WriteError| {
            Failure::Failed(format!("the netCDF file cannot be started: {error:?}"))
        };
        let mut writer =
            FileWriter::open_seek_write("", Box::new(sink.clone())).map_err(unwritten)?;
        writer
            .set_def(&self.set, Version::Offset64Bit, 0)
            .map_err(unwritten)?;
        for (name, values) in &self.fixed {
            match values {
                Values::Whole(values) => writer.write_var_i32(name, values),
                Values::Real(values) => writer.write_var_f64(name, values),
            }
            .map_err(unwritten)?;
        }
        writer.close().map_err(unwritten)?;
        let mut bytes = sink.0.take().into_inner();
        for values in &self.flags {
            zero_padding(&mut bytes, values);
        }
        Ok(bytes)
    }
}

/// Writes zeros after an attribute of small integers, up to a multiple of four bytes: netcdf3 0.6.1 writes its fill
/// value there, and readers, including its own, refuse that.
fn zero_padding(header: &mut [u8], values: &[i8]) {
    const BYTE: u32 = 1;
    let mut attribute = Vec::from(BYTE.to_be_bytes());
    attribute.extend((values.len() as u32).to_be_bytes());
    attribute.extend(values.iter().map(|value| value.to_be_bytes()[0]));
    let mut places = header.windows(attribute.len());
    if let Some(at) = places.position(|window| window == attribute) {
        let (begin, end) = (
            at + attribute.len(),
            at + attribute.len().next_multiple_of(4),
        );
        header[begin..end].fill(0);
    }
}

/// A record: the values of its variables in the order of definition, big-endian, each padded to a multiple of four
/// bytes.
#[derive(Debug, Default)]
pub(super) struct RecordBytes(Vec<u8>);

impl RecordBytes {
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    pub(super) fn whole(&mut self, value: i32) {
        self.0.extend(value.to_be_bytes());
    }

    pub(super) fn reals(&mut self, values: impl IntoIterator<Item = f64>) {
        for value in values {
            self.0.extend(value.to_be_bytes());
        }
    }

    pub(super) fn small(&mut self, values: impl IntoIterator<Item = i8>) {
        self.0
            .extend(values.into_iter().map(|value| value.to_be_bytes()[0]));
        self.0.resize(self.0.len().next_multiple_of(4), 0);
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.0
    }
}

fn invalid(error: InvalidDataSet) -> Failure {
    Failure::Failed(format!(
        "the session cannot be written as a netCDF file: {error}"
    ))
}

/// Bytes in memory that remain after the writer, which owns its output, is dropped.
#[derive(Debug, Clone, Default)]
struct Shared(Rc<RefCell<Cursor<Vec<u8>>>>);

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.borrow_mut().write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Seek for Shared {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.0.borrow_mut().seek(to)
    }
}
