use std::collections::BTreeSet;

use dbus::MANAGER_INTERFACE;

use super::table::METHODS;
use super::*;

/// Names of all `element`s whose tag contains `containing`.
fn named<'a>(xml: &'a str, element: &str, containing: &str) -> Vec<&'a str> {
    let opening = format!("<{element} name=\"");
    xml.split(&opening)
        .skip(1)
        .filter(|rest| {
            rest.split('>')
                .next()
                .is_some_and(|tag| tag.contains(containing))
        })
        .filter_map(|rest| rest.split('"').next())
        .collect()
}

fn rows<'a>(
    table: impl ExactSizeIterator<Item = (&'a str, &'a str)>,
) -> BTreeSet<(&'a str, &'a str)> {
    let all = table.len();
    let rows: BTreeSet<_> = table.collect();
    assert_eq!(rows.len(), all, "a row is there twice");
    rows
}

#[test]
fn every_method_has_its_row_and_no_property_can_be_set() {
    let mut methods = BTreeSet::new();
    let mut setters = BTreeSet::new();
    for (interface, xml) in dbus::INTERFACE_XML {
        methods.extend(
            named(xml, "method", "")
                .into_iter()
                .map(|name| (interface, name)),
        );
        setters.extend(
            named(xml, "property", "write")
                .into_iter()
                .map(|name| (interface, name)),
        );
    }
    assert!(methods.contains(&(MANAGER_INTERFACE, "OpenAll")));
    let in_table = METHODS.iter().map(|(of, member, ..)| (*of, *member));
    assert_eq!(methods, rows(in_table));
    // the check in front of the objects refuses every setter
    assert!(setters.is_empty(), "{setters:?}");
    // checks that the XML parser finds a writable property if there is one
    let xml = "<property name=\"A\" type=\"s\" access=\"readwrite\"/><property name=\"B\" access=\"read\"/>";
    assert_eq!(named(xml, "property", "write"), ["A"]);
}

#[test]
fn every_checked_action_is_declared_to_polkit() {
    let policy = include_str!("../../../../systemd/org.tactus.Tactus1.policy");
    let declared: BTreeSet<&str> = policy
        .split("<action id=\"")
        .skip(1)
        .filter_map(|rest| rest.split('"').next())
        .collect();
    let requested: BTreeSet<&str> = METHODS
        .iter()
        .map(|(_, _, action, _)| action)
        .filter_map(|action| action.id())
        .collect();
    assert_eq!(declared, requested);
    // the daemon is not root: polkit reports on other users only to the owner of the action
    let owners = policy
        .matches("<annotate key=\"org.freedesktop.policykit.owner\">")
        .count();
    assert_eq!(owners, declared.len());
    let rules = include_str!("../../../../systemd/org.tactus.Tactus1.rules");
    assert!(rules.contains("\"org.tactus.Tactus1.\"") && rules.contains("\"tactus\""));
}

#[test]
fn queries_never_use_up_the_limit_of_safety_calls() {
    for (interface, member, action, class) in METHODS {
        let looks = *action == Action::Observe;
        let own = matches!(class, CallClass::Command | CallClass::Safety);
        assert!(!(looks && own), "{interface}.{member}");
    }
    let safe: Vec<&str> = METHODS
        .iter()
        .filter(|(.., class)| *class == CallClass::Safety)
        .map(|(_, member, ..)| *member)
        .collect();
    assert_eq!(safe, ["OpenAll", "Stop", "Suspend"]);
    assert!(!std::ptr::eq(
        CallClass::Query.limit(),
        CallClass::Safety.limit()
    ));
}
