//! The table of all headers: the rows of each chapter of commands, in the order in which they are searched.

use std::sync::LazyLock;

use scpi::{Call, ParseError};

use super::grammar::Table;
use super::{Command, calculate, function, measure, route, sense, system};

static GRAMMAR: LazyLock<Table> = LazyLock::new(|| {
    let mut table = Table::default();
    // the table is searched in order: the most frequent headers come first
    route::rows(&mut table);
    measure::rows(&mut table);
    sense::rows(&mut table);
    system::rows(&mut table);
    function::rows(&mut table);
    calculate::rows(&mut table);
    table
});

/// Parses a call that is not a common command.
pub(super) fn read(call: &Call) -> Result<Command, ParseError> {
    GRAMMAR.read(call)
}
