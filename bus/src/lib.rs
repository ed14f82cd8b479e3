//! The D-Bus contract of Tactus: names, interfaces, wire types. Nothing of ours inside.
