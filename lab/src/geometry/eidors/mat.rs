//! Reads MATLAB's MAT-files of version 5 (saved by `-v6`, `-v7`) in either byte order: numbers, text, cells,
//! structures, sparse matrices. Variables of other classes (function handles, objects) are skipped. The layout is
//! described in MathWorks' "MAT-File Format".

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Read;

use flate2::read::ZlibDecoder;

/// Types of data elements.
mod element {
    pub(super) const MATRIX: u32 = 14;
    pub(super) const COMPRESSED: u32 = 15;
}

/// Bytes before the first variable of a file.
const HEAD: usize = 128;
/// Most bytes of an inflated variable: the format counts in 31 bits.
const MOST_BYTES: u64 = 1 << 31;
/// Most entries of a sparse matrix as a full one: the patterns of a thousand electrodes.
const MOST_SPARSE: usize = 1 << 24;
/// Most levels of nested structures; no program writes more.
const DEEPEST: usize = 64;

/// A variable, or a field of one.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Value {
    /// Real numbers or truth values, column after column. With more than two dimensions, all but the first are combined
    /// to one.
    Numbers {
        rows: usize,
        columns: usize,
        values: Vec<f64>,
    },
    Text(String),
    /// An array of structures: a map from field to value for each.
    Structs(Vec<BTreeMap<String, Value>>),
    Cells(Vec<Value>),
    /// The class of a value that this reader does not support, in words.
    Other(&'static str),
}

impl Value {
    /// Class of the value, in words.
    pub(super) fn kind(&self) -> String {
        match self {
            Self::Numbers { rows, columns, .. } => format!("a matrix of {rows} x {columns}"),
            Self::Text(_) => "text".to_owned(),
            Self::Structs(structs) => format!("an array of {} structures", structs.len()),
            Self::Cells(cells) => format!("a cell array of {}", cells.len()),
            Self::Other(what) => (*what).to_owned(),
        }
    }
}

/// Why a file is not read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum MatError {
    #[error("it is no MAT-file")]
    Foreign,
    #[error("it is of version 7.3, which is HDF5: save it in MATLAB with '-v7'")]
    Newer,
    #[error("it is damaged at byte {0} of a variable, or cut short")]
    Damaged(usize),
    #[error("a variable cannot be inflated: {0}")]
    Deflated(String),
}

/// The variables of a file by name.
pub(super) fn variables(bytes: &[u8]) -> Result<BTreeMap<String, Value>, MatError> {
    if bytes.starts_with(b"\x89HDF") || bytes.starts_with(b"MATLAB 7.3") {
        return Err(MatError::Newer);
    }
    let head = bytes.get(..HEAD).ok_or(MatError::Foreign)?;
    let big = match &head[126..] {
        b"IM" => false,
        b"MI" => true,
        _ => return Err(MatError::Foreign),
    };
    let mut rest = Reader {
        bytes: &bytes[HEAD..],
        at: 0,
        big,
    };
    let mut variables = BTreeMap::new();
    while rest.at < rest.bytes.len() {
        let (kind, content) = rest.element()?;
        let content = match kind {
            element::COMPRESSED => Cow::Owned(inflated(content)?),
            element::MATRIX => Cow::Borrowed(content),
            _ => continue,
        };
        let mut inner = Reader {
            bytes: &content,
            at: 0,
            big,
        };
        let (name, value) = match kind {
            element::COMPRESSED => inner.matrix(0)?,
            _ => inner.array(0)?,
        };
        variables.insert(name, value);
    }
    Ok(variables)
}

fn inflated(deflated: &[u8]) -> Result<Vec<u8>, MatError> {
    let mut bytes = Vec::new();
    ZlibDecoder::new(deflated)
        .take(MOST_BYTES)
        .read_to_end(&mut bytes)
        .map_err(|fault| MatError::Deflated(fault.to_string()))?;
    Ok(bytes)
}

/// Reads elements one after the other.
struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    big: bool,
}

impl<'a> Reader<'a> {
    fn damaged<T>(&self) -> Result<T, MatError> {
        Err(MatError::Damaged(self.at))
    }

    fn word(&self, at: usize) -> Result<u32, MatError> {
        let word = self.bytes.get(at..).and_then(|rest| rest.first_chunk());
        match (word, self.big) {
            (Some(word), false) => Ok(u32::from_le_bytes(*word)),
            (Some(word), true) => Ok(u32::from_be_bytes(*word)),
            (None, _) => self.damaged(),
        }
    }

    /// Type and content of the next element; a content of at most four bytes can be in the tag.
    fn element(&mut self) -> Result<(u32, &'a [u8]), MatError> {
        let tag = self.word(self.at)?;
        let (kind, length, begin) = match tag >> 16 {
            0 => (tag, self.word(self.at + 4)? as usize, self.at + 8),
            length => (tag & 0xffff, length as usize, self.at + 4),
        };
        let Some(content) = self.bytes.get(begin..begin + length) else {
            return self.damaged();
        };
        self.at = match (begin - self.at, kind) {
            (4, _) => self.at + 8,
            (_, element::COMPRESSED) => begin + length,
            _ => begin + length.next_multiple_of(8),
        };
        Ok((kind, content))
    }

    /// Numbers of any numeric type.
    fn numbers(&mut self) -> Result<Vec<f64>, MatError> {
        let (kind, bytes) = self.element()?;
        macro_rules! read {
            ($type:ty) => {{
                let (chunks, rest) = bytes.as_chunks::<{ size_of::<$type>() }>();
                if !rest.is_empty() {
                    return self.damaged();
                }
                let number = |chunk: &[u8; size_of::<$type>()]| match self.big {
                    false => <$type>::from_le_bytes(*chunk) as f64,
                    true => <$type>::from_be_bytes(*chunk) as f64,
                };
                chunks.iter().map(number).collect()
            }};
        }
        Ok(match kind {
            1 => read!(i8),
            2 | 16 => read!(u8),
            3 => read!(i16),
            4 | 17 => read!(u16),
            5 => read!(i32),
            6 | 18 => read!(u32),
            7 => read!(f32),
            9 => read!(f64),
            12 => read!(i64),
            13 => read!(u64),
            _ => return self.damaged(),
        })
    }

    fn indices(&mut self) -> Result<Vec<usize>, MatError> {
        let numbers = self.numbers()?;
        match numbers
            .iter()
            .all(|n| (0.0..4e9).contains(n) && n.fract() == 0.0)
        {
            true => Ok(numbers.into_iter().map(|n| n as usize).collect()),
            false => self.damaged(),
        }
    }

    fn text(&mut self) -> Result<String, MatError> {
        let units = self.indices()?;
        let units: Vec<u16> = units.into_iter().map(|unit| unit as u16).collect();
        Ok(String::from_utf16_lossy(&units))
    }

    /// Name and value of an array, including its tag.
    fn matrix(&mut self, depth: usize) -> Result<(String, Value), MatError> {
        let (kind, bytes) = self.element()?;
        if kind != element::MATRIX {
            return self.damaged();
        }
        let mut inner = Reader {
            bytes,
            at: 0,
            ..*self
        };
        inner.array(depth)
    }

    /// Name and value of an array, after its tag.
    fn array(&mut self, depth: usize) -> Result<(String, Value), MatError> {
        // for a field without a value MATLAB writes no bytes
        if self.bytes.is_empty() {
            let (rows, columns, values) = (0, 0, Vec::new());
            return Ok((
                String::new(),
                Value::Numbers {
                    rows,
                    columns,
                    values,
                },
            ));
        }
        if depth > DEEPEST {
            return self.damaged();
        }
        let flags = self.indices()?;
        let (class, complex) = match flags.first() {
            Some(flags) => (flags & 0xff, flags & 0x800 != 0),
            None => return self.damaged(),
        };
        if class > 15 {
            return Ok((
                String::new(),
                Value::Other("a function handle or an object"),
            ));
        }
        let dimensions = self.indices()?;
        let [rows, ref more @ ..] = dimensions[..] else {
            return self.damaged();
        };
        let count = |lengths: &[usize]| {
            let product = lengths
                .iter()
                .try_fold(1_usize, |all, n| all.checked_mul(*n));
            product.filter(|count| *count < MOST_BYTES as usize)
        };
        let (Some(all), Some(columns)) = (count(&dimensions), count(more)) else {
            return self.damaged();
        };
        let name = self.text()?;
        let value = match class {
            _ if complex => Value::Other("a matrix of complex numbers"),
            1 => Value::Cells(self.values(all, depth)?),
            2 => self.structs(all, depth)?,
            3 => Value::Other("an object"),
            4 => Value::Text(self.text()?),
            5 => self.sparse(rows, columns)?,
            _ => {
                let values = self.numbers()?;
                if values.len() != all {
                    return self.damaged();
                }
                Value::Numbers {
                    rows,
                    columns,
                    values,
                }
            }
        };
        Ok((name, value))
    }

    fn values(&mut self, count: usize, depth: usize) -> Result<Vec<Value>, MatError> {
        let mut values = Vec::new();
        for _ in 0..count {
            values.push(self.matrix(depth + 1)?.1);
        }
        Ok(values)
    }

    fn structs(&mut self, count: usize, depth: usize) -> Result<Value, MatError> {
        let Some(&length) = self.indices()?.first().filter(|length| **length > 0) else {
            return self.damaged();
        };
        let (_, names) = self.element()?;
        let name = |bytes: &[u8]| {
            let bytes: Vec<u8> = bytes
                .iter()
                .copied()
                .take_while(|byte| *byte != 0)
                .collect();
            String::from_utf8_lossy(&bytes).into_owned()
        };
        let names: Vec<String> = names.chunks(length).map(name).collect();
        if names.is_empty() && count > 1 {
            return self.damaged();
        }
        let mut structs = Vec::new();
        for _ in 0..count {
            let values = self.values(names.len(), depth)?;
            structs.push(names.iter().cloned().zip(values).collect());
        }
        Ok(Value::Structs(structs))
    }

    /// A sparse matrix, expanded to a full one.
    fn sparse(&mut self, rows: usize, columns: usize) -> Result<Value, MatError> {
        let (places, begins, entries) = (self.indices()?, self.indices()?, self.numbers()?);
        let whole = begins.is_sorted()
            && begins.len() == columns + 1
            && begins.last().is_some_and(|n| *n <= entries.len());
        if !whole || entries.len() > places.len() {
            return self.damaged();
        }
        if rows * columns > MOST_SPARSE {
            return Ok(Value::Other("a sparse matrix that is too large"));
        }
        let mut values = vec![0.0; rows * columns];
        for (column, range) in begins.windows(2).enumerate() {
            for entry in range[0]..range[1] {
                if places[entry] >= rows {
                    return self.damaged();
                }
                values[column * rows + places[entry]] = entries[entry];
            }
        }
        Ok(Value::Numbers {
            rows,
            columns,
            values,
        })
    }
}
