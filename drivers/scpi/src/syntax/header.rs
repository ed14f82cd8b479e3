//! Matches headers against the notation of instrument manuals: `[SOURce]:CURRent[:LEVel][:IMMediate][:AMPLitude]`.

use crate::Call;

#[derive(Debug, Clone, PartialEq, Eq)]
struct Node {
    short: String,
    long: String,
    numbered: bool,
    optional: bool,
}

impl Node {
    /// The numeric suffix if the keyword matches this node: `Some(None)` for a node without suffix. A suffix of 1 is
    /// allowed on any node (SCPI-99 volume 1, 6.2.5.2).
    fn suffix(&self, keyword: &str) -> Option<Option<u32>> {
        let whole = |word: &str| {
            word.eq_ignore_ascii_case(&self.short) || word.eq_ignore_ascii_case(&self.long)
        };
        if !self.numbered {
            // A node whose own name ends in a digit (`CALCulate2`) takes no suffix.
            let plain = !self.short.ends_with(|c: char| c.is_ascii_digit());
            let with_one = || plain && keyword.strip_suffix('1').is_some_and(whole);
            return (whole(keyword) || with_one()).then_some(None);
        }
        let stem = keyword.trim_end_matches(|c: char| c.is_ascii_digit());
        if !whole(stem) {
            return None;
        }
        match &keyword[stem.len()..] {
            "" => Some(Some(1)),
            digits => digits.parse().ok().map(Some),
        }
    }
}

/// A header in the notation of manuals: capitals are the short form, brackets an optional node, `<n>` a numeric suffix
/// (1 when left out), a leading `*` a common command, a trailing `?` a query. A notation without `?` matches both
/// command and query.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pattern {
    nodes: Vec<Node>,
    common: bool,
    query: bool,
}

impl Pattern {
    /// Parses the notation.
    ///
    /// # Panics
    /// If the notation is malformed. It is part of the program, not of its input.
    pub fn new(notation: &str) -> Self {
        let (path, query) = match notation.strip_suffix('?') {
            Some(path) => (path, true),
            None => (notation, false),
        };
        let (path, common) = match path.strip_prefix('*') {
            Some(path) => (path, true),
            None => (path, false),
        };
        let mut nodes = Vec::new();
        let mut optional = false;
        let mut word = String::new();
        let mut flush = |word: &mut String, optional: bool| {
            if word.is_empty() {
                return;
            }
            let (stem, numbered) = match word.strip_suffix("<n>") {
                Some(stem) => (stem, true),
                None => (word.as_str(), false),
            };
            assert!(
                stem.starts_with(|c: char| c.is_ascii_uppercase())
                    && stem.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_'),
                "malformed header notation '{notation}'"
            );
            nodes.push(Node {
                short: stem.chars().filter(|c| !c.is_ascii_lowercase()).collect(),
                long: stem.to_ascii_uppercase(),
                numbered,
                optional,
            });
            word.clear();
        };
        for c in path.chars() {
            match c {
                '[' | ']' => {
                    flush(&mut word, optional);
                    assert!(
                        optional == (c == ']'),
                        "malformed header notation '{notation}'"
                    );
                    optional = c == '[';
                }
                ':' => flush(&mut word, optional),
                other => word.push(other),
            }
        }
        flush(&mut word, optional);
        assert!(
            !optional && !nodes.is_empty(),
            "malformed header notation '{notation}'"
        );
        Self {
            nodes,
            common,
            query,
        }
    }

    /// Whether the call's header matches this pattern.
    pub fn matches(&self, call: &Call) -> bool {
        self.suffixes(call).is_some()
    }

    /// The numeric suffixes of the call's header, one for each `<n>` of the notation whose node was written; `None` if
    /// the header does not match.
    pub fn suffixes(&self, call: &Call) -> Option<Vec<u32>> {
        if self.common != call.common || (self.query && !call.query) {
            return None;
        }
        let mut suffixes = Vec::new();
        let found = match (self.common, call.header.as_slice()) {
            // A common command has no suffix.
            (true, [keyword]) => {
                let is = |node: &Node| keyword.eq_ignore_ascii_case(&node.long);
                self.nodes.iter().all(is)
            }
            _ => match_nodes(&self.nodes, &call.header, &mut suffixes),
        };
        found.then_some(suffixes)
    }
}

/// Matches the keyword against the first node, then, if that is optional, against the next. A notation has few optional
/// nodes, so trying both is cheap.
fn match_nodes(nodes: &[Node], keywords: &[String], suffixes: &mut Vec<u32>) -> bool {
    let Some((node, later_nodes)) = nodes.split_first() else {
        return keywords.is_empty();
    };
    if let Some((keyword, later_keywords)) = keywords.split_first()
        && let Some(suffix) = node.suffix(keyword)
    {
        let held = suffixes.len();
        suffixes.extend(suffix);
        if match_nodes(later_nodes, later_keywords, suffixes) {
            return true;
        }
        suffixes.truncate(held);
    }
    node.optional && match_nodes(later_nodes, keywords, suffixes)
}

impl Call {
    /// Whether the header matches this notation (see [`Pattern`]).
    ///
    /// # Panics
    /// If the notation is malformed.
    pub fn is(&self, notation: &str) -> bool {
        Pattern::new(notation).matches(self)
    }
}

#[cfg(test)]
mod tests {
    use crate::parse_message;
    use crate::syntax::header::*;

    fn matches(notation: &str, header: &str) -> bool {
        let call = parse_message(header).remove(0).unwrap();
        Pattern::new(notation).matches(&call)
    }

    #[test]
    fn optional_nodes_may_be_left_out_in_any_combination() {
        let level = "[SOURce]:CURRent[:LEVel][:IMMediate][:AMPLitude]";
        for header in [
            "CURR",
            "SOUR:CURR",
            ":source:current:level:immediate:amplitude",
            "curr:ampl",
            "CURR:LEV:AMPL?",
        ] {
            assert!(matches(level, header), "{header}");
        }
        for header in [
            "SOUR",
            "CURR:RANG",
            "CURR:IMM:LEV",
            "SOUR:SOUR:CURR",
            "*CURR",
        ] {
            assert!(!matches(level, header), "{header}");
        }
    }

    #[test]
    fn a_keyword_is_its_long_or_short_form_and_nothing_between() {
        assert!(matches("SYSTem:PRESet", "syst:pres"));
        assert!(matches("SYSTem:PRESet", "SYSTEM:PRESET"));
        // 622x Reference Manual: `SYSTe:PRES` is an error.
        assert!(!matches("SYSTem:PRESet", "SYSTe:PRES"));
        assert!(!matches("SYSTem:PRESet", "SYS:PRES"));
    }

    #[test]
    fn any_node_may_have_the_suffix_one_and_no_other() {
        let matches = |notation: &str, header: &str| {
            let call = parse_message(header).remove(0).unwrap();
            Pattern::new(notation).matches(&call)
        };
        assert!(matches("[SENSe]:VOLTage[:DC]", "SENS1:VOLT:DC1 1"));
        assert!(matches(
            "ARM[:SEQuence][:LAYer]:SOURce",
            "ARM:SEQ1:LAYER1:SOUR BUS"
        ));
        for other in ["SENS2:VOLT 1", "SENS11:VOLT 1", "SENS01:VOLT 1"] {
            assert!(!matches("[SENSe]:VOLTage[:DC]", other), "{other}");
        }
        assert!(matches("CALCulate2:STATe", "CALC2:STAT ON"));
        assert!(!matches("CALCulate2:STATe", "CALC21:STAT ON"));
        assert!(matches("*RST", "*rst"));
        assert!(!matches("*RST", "*RST1"));
    }

    #[test]
    fn numeric_suffixes_are_read_and_default_to_one() {
        let pattern = Pattern::new("OUTPut<n>[:STATe<n>]");
        let suffixes = |header: &str| {
            let call = parse_message(header).remove(0).unwrap();
            pattern.suffixes(&call)
        };
        assert_eq!(suffixes("OUTP3:STAT"), Some(vec![3, 1]));
        assert_eq!(suffixes("OUTPUT"), Some(vec![1]));
        assert_eq!(suffixes("OUTX1"), None);
    }

    #[test]
    fn the_query_mark_of_the_notation_asks_for_a_query() {
        assert!(matches("*IDN?", "*IDN?"));
        assert!(!matches("*IDN?", "*IDN"));
        assert!(matches("*ESE", "*ESE?"));
        assert!(!matches("*ESE", "ESE?"));
    }
}
