//! The table of an instrument's headers, with a reader of the arguments for each.

use crate::{Call, ParseError, Pattern};

type Reader<C> = Box<dyn Fn(&Call) -> Result<C, ParseError> + Send + Sync>;

/// Headers in the notation of manuals, each with the command that a call of it means. The rows are searched in the order
/// in which they were added.
pub struct Table<C>(Vec<(bool, Pattern, Reader<C>)>);

impl<C> Default for Table<C> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<C: Clone + Send + Sync + 'static> Table<C> {
    /// Adds a header, ending in `?` for queries.
    pub fn add<T: Into<C>>(
        &mut self,
        notation: &str,
        read: impl Fn(&Call) -> Result<T, ParseError> + Send + Sync + 'static,
    ) {
        let read: Reader<C> = Box::new(move |call| read(call).map(Into::into));
        self.0
            .push((notation.ends_with('?'), Pattern::new(notation), read));
    }

    /// Adds the header of a command without arguments.
    pub fn plain(&mut self, notation: &str, command: impl Into<C>) {
        let command = command.into();
        self.add(notation, move |call| {
            call.exactly::<0>().map(|_| command.clone())
        });
    }

    /// Adds the header of a command whose only argument is a boolean.
    pub fn switch<T: Into<C>>(
        &mut self,
        notation: &str,
        command: impl Fn(bool) -> T + Send + Sync + 'static,
    ) {
        self.add(notation, move |call| {
            let [on] = call.exactly()?;
            on.boolean().map(&command)
        });
    }

    /// Parses a call by the first row that matches its header.
    ///
    /// # Errors
    /// -113 if no row matches, or the error of the arguments.
    pub fn read(&self, call: &Call) -> Result<C, ParseError> {
        self.0
            .iter()
            .find(|(query, pattern, _)| *query == call.query && pattern.matches(call))
            .map_or(Err(ParseError::UndefinedHeader), |(_, _, read)| read(call))
    }
}
