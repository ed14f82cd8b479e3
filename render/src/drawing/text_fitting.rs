//! Text shortened to the available width.

use crate::PictureError;

/// Text on two lines, broken at the last space at which the first line fits; the second line is cut to fit.
pub(crate) fn two_lines(
    words: &str,
    available: f64,
    width: impl Fn(&str) -> Result<f64, PictureError>,
) -> Result<[String; 2], PictureError> {
    let mut first = 0;
    for (gap, _) in words.match_indices(' ') {
        if width(&words[..gap])? > available {
            break;
        }
        first = gap;
    }
    let (first, second) = words.split_at(first);
    Ok([
        shortened(first, available, &width)?,
        shortened(second.trim_start(), available, &width)?,
    ])
}

/// Text that fits the width, with an ellipsis if it was cut.
pub(crate) fn shortened(
    words: &str,
    available: f64,
    width: impl Fn(&str) -> Result<f64, PictureError>,
) -> Result<String, PictureError> {
    if width(words)? <= available {
        return Ok(words.to_owned());
    }
    let signs: Vec<char> = words.chars().collect();
    let (mut fits, mut over) = (0, signs.len());
    let cut = |count: usize| {
        let kept: String = signs[..count].iter().collect();
        format!("{}\u{2026}", kept.trim_end_matches([' ', ',', ';']))
    };
    while fits + 1 < over {
        let half = fits.midpoint(over);
        if width(&cut(half))? <= available {
            fits = half;
        } else {
            over = half;
        }
    }
    Ok(cut(fits))
}

#[cfg(test)]
mod tests {
    use crate::drawing::text_fitting::*;

    /// A font whose letters are all ten points wide.
    fn ten(words: &str) -> Result<f64, PictureError> {
        Ok(10.0 * words.chars().count() as f64)
    }

    #[test]
    fn words_that_fit_are_not_touched_and_others_end_in_an_ellipsis() {
        assert_eq!(shortened("a press", 70.0, ten).unwrap(), "a press");
        assert_eq!(shortened("a press", 60.0, ten).unwrap(), "a pre\u{2026}");
        assert_eq!(shortened("a, press", 40.0, ten).unwrap(), "a\u{2026}");
    }

    #[test]
    fn a_long_title_has_two_lines() {
        let lines = two_lines("one two three four", 80.0, ten).unwrap();
        assert_eq!(lines, ["one two", "three f\u{2026}"]);
        let endless = two_lines("onetwothree", 60.0, ten).unwrap();
        assert_eq!(endless, ["", "onetw\u{2026}"]);
    }
}
