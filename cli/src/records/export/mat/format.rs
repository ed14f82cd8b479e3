//! Writes MATLAB's MAT-files of version 5 with deflated variables (as MATLAB saves with `-v7`): numbers, text, arrays
//! of structures, sparse matrices. Little-endian. The layout is described in MathWorks' "MAT-File Format".

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;

/// Types of data elements.
mod element {
    pub(super) const INT8: u32 = 1;
    pub(super) const UINT16: u32 = 4;
    pub(super) const INT32: u32 = 5;
    pub(super) const UINT32: u32 = 6;
    pub(super) const DOUBLE: u32 = 9;
    pub(super) const MATRIX: u32 = 14;
    pub(super) const COMPRESSED: u32 = 15;
}

/// Classes of arrays.
mod class {
    pub(super) const STRUCT: u32 = 2;
    pub(super) const CHAR: u32 = 4;
    pub(super) const SPARSE: u32 = 5;
    pub(super) const DOUBLE: u32 = 6;
}

/// Most bytes of one variable before deflating: MATLAB reads no larger ones in this version of the format.
pub(super) const MOST_BYTES: u64 = (1 << 31) - 1;
/// Bytes of a field's name including its terminator.
const FIELD: usize = 32;

/// A variable.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Value {
    /// A matrix, column after column.
    Numbers {
        rows: usize,
        columns: usize,
        values: Vec<f64>,
    },
    /// A row of characters.
    Text(String),
    /// A row of structures with these fields; each element has a value for each field.
    Structs {
        fields: Vec<&'static str>,
        elements: Vec<Vec<Value>>,
    },
    /// A sparse matrix: entries as (row, column, value), in any order, each position at most once.
    Sparse {
        rows: usize,
        columns: usize,
        entries: Vec<(usize, usize, f64)>,
    },
}

impl Value {
    pub(super) fn number(value: f64) -> Self {
        Self::Numbers {
            rows: 1,
            columns: 1,
            values: vec![value],
        }
    }

    pub(super) fn row(values: Vec<f64>) -> Self {
        let (rows, columns) = (1, values.len());
        Self::Numbers {
            rows,
            columns,
            values,
        }
    }

    pub(super) fn column(values: Vec<f64>) -> Self {
        let (rows, columns) = (values.len(), 1);
        Self::Numbers {
            rows,
            columns,
            values,
        }
    }

    pub(super) fn text(text: &str) -> Self {
        Self::Text(text.to_owned())
    }

    /// One structure.
    pub(super) fn structure(fields: Vec<(&'static str, Self)>) -> Self {
        let (fields, element) = fields.into_iter().unzip();
        Self::Structs {
            fields,
            elements: vec![element],
        }
    }

    /// Class, dimensions and number of stored elements.
    fn shape(&self) -> (u32, [usize; 2], usize) {
        match self {
            Self::Numbers { rows, columns, .. } => (class::DOUBLE, [*rows, *columns], 0),
            Self::Text(text) => (class::CHAR, [1, text.encode_utf16().count()], 0),
            Self::Structs { elements, .. } => (class::STRUCT, [1, elements.len()], 0),
            Self::Sparse {
                rows,
                columns,
                entries,
            } => (class::SPARSE, [*rows, *columns], entries.len().max(1)),
        }
    }

    /// Bytes of the array without its own tag.
    fn bytes(&self, name: &str) -> u64 {
        let head = element_bytes(8) + element_bytes(8) + element_bytes(name.len() as u64);
        head + match self {
            Self::Numbers { values, .. } => element_bytes(8 * values.len() as u64),
            Self::Text(text) => element_bytes(2 * text.encode_utf16().count() as u64),
            Self::Structs { fields, elements } => {
                let names = element_bytes(4) + element_bytes((FIELD * fields.len()) as u64);
                let arrays = elements.iter().flatten();
                names + arrays.map(|array| 8 + array.bytes("")).sum::<u64>()
            }
            Self::Sparse {
                columns, entries, ..
            } => {
                let count = entries.len() as u64;
                element_bytes(4 * count)
                    + element_bytes(4 * (*columns as u64 + 1))
                    + element_bytes(8 * count)
            }
        }
    }

    fn put(&self, name: &str, to: &mut impl Write) -> std::io::Result<()> {
        let (class, dimensions, stored) = self.shape();
        let words = |numbers: &[u32]| numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        let words: &dyn Fn(&[u32]) -> Vec<u8> = &words;
        tag(to, element::MATRIX, self.bytes(name))?;
        put_element(to, element::UINT32, &words(&[class, count(stored)]))?;
        put_element(to, element::INT32, &words(&dimensions.map(count)))?;
        put_element(to, element::INT8, name.as_bytes())?;
        match self {
            Self::Numbers { values, .. } => put_numbers(to, values.iter().copied()),
            Self::Text(text) => {
                let units: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
                put_element(to, element::UINT16, &units)
            }
            Self::Structs { fields, elements } => {
                put_element(to, element::INT32, &words(&[count(FIELD)]))?;
                let mut names = vec![0; FIELD * fields.len()];
                for (place, field) in names.chunks_mut(FIELD).zip(fields) {
                    place[..field.len()].copy_from_slice(field.as_bytes());
                }
                put_element(to, element::INT8, &names)?;
                elements
                    .iter()
                    .flatten()
                    .try_for_each(|array| array.put("", to))
            }
            Self::Sparse {
                columns, entries, ..
            } => {
                let mut entries = entries.clone();
                entries.sort_by_key(|&(row, column, _)| (column, row));
                let rows: Vec<u32> = entries.iter().map(|entry| count(entry.0)).collect();
                let before = |column| entries.partition_point(|entry| entry.1 < column);
                let begins: Vec<u32> = (0..=*columns).map(|at| count(before(at))).collect();
                put_element(to, element::INT32, &words(&rows))?;
                put_element(to, element::INT32, &words(&begins))?;
                put_numbers(to, entries.iter().map(|entry| entry.2))
            }
        }
    }
}

/// The header of a file.
pub(super) fn head(text: &str) -> Vec<u8> {
    let mut head = vec![b' '; 116];
    let text = text.bytes().filter(u8::is_ascii).take(116);
    for (place, byte) in head.iter_mut().zip(text) {
        *place = byte;
    }
    head.extend([0; 8]);
    head.extend([0x00, 0x01]);
    head.extend(b"IM");
    head
}

/// A deflated variable of a file; `None` if it is larger than the format allows.
pub(super) fn variable(name: &str, value: &Value) -> std::io::Result<Option<Vec<u8>>> {
    if value.bytes(name) > MOST_BYTES {
        return Ok(None);
    }
    let mut deflated = ZlibEncoder::new(vec![0; 8], Compression::default());
    value.put(name, &mut deflated)?;
    let mut bytes = deflated.finish()?;
    let mut begin = Vec::new();
    tag(&mut begin, element::COMPRESSED, bytes.len() as u64 - 8)?;
    bytes[..8].copy_from_slice(&begin);
    Ok(Some(bytes))
}

/// A count in 32 bits, as the format requires; [`MOST_BYTES`] keeps every count below that.
fn count(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

/// Bytes of an element with its tag and padding.
fn element_bytes(bytes: u64) -> u64 {
    match bytes {
        1..=4 => 8,
        _ => 8 + bytes.next_multiple_of(8),
    }
}

fn tag(to: &mut impl Write, kind: u32, bytes: u64) -> std::io::Result<()> {
    to.write_all(&kind.to_le_bytes())?;
    to.write_all(&u32::try_from(bytes).unwrap_or(u32::MAX).to_le_bytes())
}

/// Writes an element; a content of at most four bytes is put into the tag.
fn put_element(to: &mut impl Write, kind: u32, bytes: &[u8]) -> std::io::Result<()> {
    if (1..=4).contains(&bytes.len()) {
        to.write_all(&(count(bytes.len()) << 16 | kind).to_le_bytes())?;
        to.write_all(bytes)?;
        return to.write_all(&[0; 4][bytes.len()..]);
    }
    tag(to, kind, bytes.len() as u64)?;
    to.write_all(bytes)?;
    to.write_all(&[0; 8][..bytes.len().next_multiple_of(8) - bytes.len()])
}

fn put_numbers(
    to: &mut impl Write,
    values: impl ExactSizeIterator<Item = f64>,
) -> std::io::Result<()> {
    tag(to, element::DOUBLE, 8 * values.len() as u64)?;
    for value in values {
        to.write_all(&value.to_le_bytes())?;
    }
    Ok(())
}
