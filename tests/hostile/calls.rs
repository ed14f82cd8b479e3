//! Every call of the interfaces with hostile arguments, derived from the kept introspection data, so that a new method,
//! property or option is included automatically.

use std::collections::{BTreeSet, HashMap};

use dbus::{INSTRUMENT_INTERFACE, INTERFACE_XML, ROOT_PATH, SESSION_INTERFACE};
use zbus::{Structure, Variant};

/// A message body that can be sent many times.
type Body = Structure<'static>;

/// One call.
#[derive(Debug)]
pub struct Call {
    pub path: String,
    pub interface: String,
    pub member: String,
    /// `None`: without arguments.
    pub body: Option<Body>,
}

/// An option of an `a{sv}` argument, as the comments in the interface data name it: its name and its type.
type Named = (String, char);

/// The calls of every method and property, on the objects of this session and this instrument.
pub fn all(session: &str, instrument: &str) -> Vec<Call> {
    let mut calls = Vec::new();
    for (interface, xml) in INTERFACE_XML {
        let path = match interface {
            SESSION_INTERFACE => session,
            INSTRUMENT_INTERFACE => instrument,
            _ => ROOT_PATH,
        };
        let options = options(xml);
        for (member, arguments) in methods(xml) {
            for body in bodies(interface, member, &arguments, &options) {
                calls.push(call(path, interface, member, body));
            }
        }
        calls.extend(standard(path, interface, &properties(xml)));
    }
    calls
}

fn call(path: &str, interface: &str, member: &str, body: Option<Body>) -> Call {
    Call {
        path: path.to_owned(),
        interface: interface.to_owned(),
        member: member.to_owned(),
        body,
    }
}

/// The standard interfaces of every object: properties, introspection, peer.
fn standard(path: &str, interface: &str, properties: &[&str]) -> Vec<Call> {
    let freedesktop = |name: &str| format!("org.freedesktop.DBus.{name}");
    let of_properties = |member: &str, arguments: Vec<Variant<'static>>| {
        call(
            path,
            &freedesktop("Properties"),
            member,
            Some(body(arguments)),
        )
    };
    let mut calls = vec![
        of_properties("GetAll", vec![text(interface)]),
        of_properties("GetAll", vec![text("no.such.Interface")]),
        of_properties("Get", vec![text(interface), text("NoSuchProperty")]),
        call(path, &freedesktop("Introspectable"), "Introspect", None),
        call(path, &freedesktop("Peer"), "Ping", None),
        call(path, &freedesktop("Peer"), "GetMachineId", None),
        call(
            ROOT_PATH,
            &freedesktop("ObjectManager"),
            "GetManagedObjects",
            None,
        ),
        call(path, interface, "NoSuchMethod", None),
        call("/no/such/object", interface, "NoSuchMethod", None),
    ];
    for property in properties {
        calls.push(of_properties("Get", vec![text(interface), text(property)]));
        for value in values('v') {
            calls.push(of_properties(
                "Set",
                vec![text(interface), text(property), value],
            ));
        }
    }
    calls
}

fn text(text: &str) -> Variant<'static> {
    Variant::from(text.to_owned())
}

fn body(arguments: Vec<Variant<'static>>) -> Body {
    let mut builder = Structure::builder();
    for argument in arguments {
        builder = builder.append_field(argument);
    }
    builder.build().unwrap()
}

/// Varies each argument through all its values, with ordinary values for the others.
fn bodies(
    interface: &str,
    member: &str,
    arguments: &[&str],
    options: &[Named],
) -> Vec<Option<Body>> {
    if arguments.is_empty() {
        return vec![None];
    }
    let columns: Vec<Vec<Variant<'static>>> = arguments
        .iter()
        .map(|signature| match *signature {
            "a{sv}" => dictionaries(options),
            "as" => lists(),
            "d" | "t" | "b" | "s" => values(signature.chars().next().unwrap_or('s')),
            _ => panic!(
                "{interface}.{member} takes '{signature}'; add hostile values of that type here"
            ),
        })
        .collect();
    let rounds = columns.iter().map(Vec::len).max().unwrap_or(0);
    (0..rounds)
        .map(|round| {
            let row = columns
                .iter()
                .map(|values| values[round % values.len()].try_clone().unwrap());
            Some(body(row.collect()))
        })
        .collect()
}

/// Hostile values of a basic type.
fn values(signature: char) -> Vec<Variant<'static>> {
    match signature {
        'd' => [
            1e308,
            -1e308,
            f64::MAX,
            f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::MIN_POSITIVE,
            5e-324,
            -0.0,
            0.0,
            1.8e19,
            0.5,
        ]
        .map(Variant::from)
        .into(),
        't' => [0, 1, 10_000, 1 << 63, u64::MAX].map(Variant::from).into(),
        'b' => [true, false].map(Variant::from).into(),
        's' => texts().into_iter().map(Variant::from).collect(),
        'v' => "dtbs"
            .chars()
            .filter_map(|signature| values(signature).into_iter().next())
            .map(|value| Variant::Variant(Box::new(value)))
            .collect(),
        other => panic!("there are no hostile values of the type '{other}' yet; add some here"),
    }
}

fn texts() -> Vec<String> {
    let plain = [
        "",
        "one-step",
        "/dev/zero",
        "../../../etc/shadow",
        "\n[notify]\ncommand = [\"id\"]",
        "\u{1b}]0;title\u{7}\u{202e}",
        "'; DROP TABLE frames; --",
        "%s%n{}",
    ];
    let mut texts: Vec<String> = plain.map(str::to_owned).into();
    texts.push("\u{10ffff}".repeat(25_000));
    texts
}

fn lists() -> Vec<Variant<'static>> {
    vec![
        Variant::from(Vec::<String>::new()),
        Variant::from(texts()),
        Variant::from(vec!["tcp:127.0.0.1:1"; 1000]),
    ]
}

/// Empty; each option with each value of its own type and one of each other type; an unknown option; all at once.
fn dictionaries(options: &[Named]) -> Vec<Variant<'static>> {
    let one = |name: &str, value: Variant<'static>| {
        Variant::from(HashMap::from([(name.to_owned(), value)]))
    };
    let mut dictionaries = vec![
        Variant::from(HashMap::<String, Variant<'static>>::new()),
        one("no_such_option", Variant::from(1.0)),
        one(&"x".repeat(100_000), Variant::from(1.0)),
    ];
    let mut all = HashMap::new();
    for (name, signature) in options {
        for value in values(*signature) {
            dictionaries.push(one(name, value));
        }
        let others = "dtbs".chars().filter(|other| other != signature);
        for value in others.filter_map(|other| values(other).into_iter().next()) {
            dictionaries.push(one(name, value));
        }
        all.insert(name.clone(), values(*signature).swap_remove(0));
    }
    dictionaries.push(Variant::from(all));
    dictionaries
}

/// Each method, with the signatures of its arguments.
fn methods(xml: &str) -> Vec<(&str, Vec<&str>)> {
    let mut methods: Vec<(&str, Vec<&str>)> = Vec::new();
    let mut open = false;
    for line in xml.lines().map(str::trim) {
        if line.starts_with("<method ") {
            methods.push((attribute(line, "name").unwrap(), Vec::new()));
            open = !line.ends_with("/>");
        } else if line.starts_with("</method") {
            open = false;
        } else if open
            && line.starts_with("<arg ")
            && attribute(line, "direction") == Some("in")
            && let Some((_, arguments)) = methods.last_mut()
        {
            arguments.push(attribute(line, "type").unwrap());
        }
    }
    methods
}

fn properties(xml: &str) -> Vec<&str> {
    let lines = xml.lines().map(str::trim);
    lines
        .filter(|line| line.starts_with("<property "))
        .filter_map(|line| attribute(line, "name"))
        .collect()
}

fn attribute<'a>(line: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = line.split_once(&format!("{name}=\""))?;
    Some(rest.split_once('"')?.0)
}

/// The type of a measuring option, from the error for a value of another type.
fn measuring_option(key: &str) -> Named {
    let read = dbus::Options::new()
        .with(key, "no number")
        .read::<dbus::SessionOptions>();
    let signature = match read {
        Ok(_) => 's',
        Err(error) => error
            .text
            .strip_suffix(')')
            .and_then(|text| text.chars().next_back())
            .expect("the error names the type"),
    };
    (key.to_owned(), signature)
}

/// Options are documented in comments as `name` (type); comments may wrap. Where the comments refer to the keys of
/// `[survey]`, they are the measuring options.
fn options(xml: &str) -> Vec<Named> {
    let text = xml.split_whitespace().collect::<Vec<_>>().join(" ");
    let mut found = BTreeSet::new();
    if text.contains("keys of `[survey]`") {
        found.extend(dbus::MEASURING_OPTIONS.map(measuring_option));
    }
    for (place, between) in text.match_indices("` (") {
        let name = text[..place].rsplit('`').next().unwrap_or_default();
        let mut behind = text[place + between.len()..].chars();
        if let (Some(signature @ ('d' | 't' | 'b' | 's')), Some(',' | ')')) =
            (behind.next(), behind.next())
            && name
                .chars()
                .all(|letter| letter.is_ascii_lowercase() || letter == '_')
        {
            found.insert((name.to_owned(), signature));
        }
    }
    found.into_iter().collect()
}

/// Checks that this reader finds everything in the kept interfaces.
#[test]
fn hostile_calls_cover_every_method_property_and_option() {
    let calls = all("/session", "/instrument");
    for (interface, xml) in INTERFACE_XML {
        for (tag, count) in [
            ("<method ", methods(xml).len()),
            ("<property ", properties(xml).len()),
        ] {
            assert_eq!(xml.matches(tag).count(), count, "{interface} {tag}");
        }
        for (member, _) in methods(xml) {
            let called = calls
                .iter()
                .any(|call| call.interface == interface && call.member == member);
            assert!(called, "{interface}.{member} is never called");
        }
    }
    let manager = options(INTERFACE_XML[0].1);
    for option in dbus::SESSION_OPTIONS.iter().chain(&dbus::MEASURING_OPTIONS) {
        assert!(
            manager.iter().any(|(name, _)| name == option),
            "no option '{option}' in {manager:?}"
        );
    }
    for expected in [
        ("nplc", 'd'),
        ("averages", 't'),
        ("half", 'b'),
        ("ranges", 's'),
    ] {
        let found = manager
            .iter()
            .any(|(name, signature)| (name.as_str(), *signature) == expected);
        assert!(found, "no option {expected:?} in {manager:?}");
    }
}
