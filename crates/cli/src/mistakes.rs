//! Mistakes in the arguments, in one line: which argument, what was expected, what was found.

use clap::error::{ContextKind, ContextValue, Error, ErrorKind};
use std::error::Error as _;
use std::num::{ParseFloatError, ParseIntError};

/// One line for what `clap` says in several.
pub fn line(error: &Error) -> String {
    let texts = |kind: ContextKind| match error.get(kind) {
        Some(ContextValue::String(text)) => vec![text.clone()],
        Some(ContextValue::Strings(texts)) => texts.clone(),
        _ => Vec::new(),
    };
    let text = |kind: ContextKind| texts(kind).join(", ");
    let meant = |kind: ContextKind| match &texts(kind)[..] {
        [] => String::new(),
        names => format!(" (is it {}?)", names.join(" or ")),
    };
    let argument = text(ContextKind::InvalidArg);
    match error.kind() {
        ErrorKind::InvalidValue | ErrorKind::ValueValidation => {
            let found = match text(ContextKind::InvalidValue) {
                nothing if nothing.is_empty() => "none".to_string(),
                value => format!("'{value}'"),
            };
            let expected = match (&texts(ContextKind::ValidValue)[..], error.source()) {
                ([], Some(why)) if why.to_string().starts_with("expected") => {
                    return format!("{argument}: {why}");
                }
                ([], Some(why)) if why.is::<ParseIntError>() => "a whole number".to_string(),
                ([], Some(why)) if why.is::<ParseFloatError>() => "a number".to_string(),
                ([], Some(why)) => format!("another value ({why})"),
                ([], None) => "a value".to_string(),
                (known, _) => known.join(" or "),
            };
            format!("{argument}: expected {expected}, found {found}")
        }
        ErrorKind::MissingRequiredArgument => format!("expected {argument}, found none"),
        ErrorKind::ArgumentConflict => {
            let other = text(ContextKind::PriorArg);
            if other == argument {
                format!("{argument}: expected once, found twice")
            } else {
                format!("{argument}: expected without {other}, found both")
            }
        }
        ErrorKind::UnknownArgument => format!(
            "expected arguments that --help tells of, found '{argument}'{}",
            meant(ContextKind::SuggestedArg)
        ),
        ErrorKind::InvalidSubcommand => format!(
            "expected a command that --help tells of, found '{}'{}",
            text(ContextKind::InvalidSubcommand),
            meant(ContextKind::SuggestedSubcommand)
        ),
        _ => {
            let all = error.to_string();
            let first = all.lines().next().unwrap_or_default();
            first.trim_start_matches("error: ").to_string()
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::arguments::Arguments;
    use clap::Parser;

    #[test]
    fn mistakes_name_the_argument_what_was_expected_and_what_was_found() {
        for (arguments, told) in [
            (
                "factors a.obj --error 2",
                "--error <E>: expected a number from 1e-8 to 1e-1, found '2'",
            ),
            (
                "factors a.obj --by thing",
                "--by <KIND>: expected object or material, found 'thing'",
            ),
            (
                "factors a.obj --by",
                "--by <KIND>: expected object or material, found none",
            ),
            (
                "factors a.obj -o",
                "--output <FILE>: expected a value, found none",
            ),
            (
                "factors a.obj --threads x",
                "--threads <N>: expected a whole number, found 'x'",
            ),
            (
                "light a.obj --seed 5000000000",
                "--seed <N>: expected another value (5000000000 is not in 0..=4294967295), found '5000000000'",
            ),
            ("factors", "expected <SCENE>, found none"),
            ("probe a.obj", "expected --points <FILE>, found none"),
            (
                "factors a.obj --enclosed --rows 3",
                "--enclosed: expected without --rows <A..B>, found both",
            ),
            (
                "factors a.obj --json --json",
                "--json: expected once, found twice",
            ),
            (
                "factors a.obj --errors 1",
                "expected arguments that --help tells of, found '--errors' (is it --error?)",
            ),
            (
                "factors a.obj b.obj",
                "expected arguments that --help tells of, found 'b.obj'",
            ),
            (
                "factor a.obj",
                "expected a command that --help tells of, found 'factor' (is it factors?)",
            ),
            (
                "factors a.obj --json=yes",
                "unexpected value 'yes' for '--json' found; no more were expected",
            ),
        ] {
            let words = ["luxel"].into_iter().chain(arguments.split(' '));
            let error = Arguments::try_parse_from(words).expect_err(arguments);
            assert_eq!(super::line(&error), told, "luxel {arguments}");
        }
    }
}
