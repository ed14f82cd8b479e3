//! Errors in the validation of a mesh.

use survey::Electrode;

/// Why nodes, triangles and electrodes are not a valid mesh. Elements and nodes are counted from 0 as in case folders,
/// electrodes from 1.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// No triangle.
    #[error("a mesh needs at least one triangle")]
    Empty,
    /// A coordinate is NaN or infinite.
    #[error("node {node} has a coordinate that is not finite")]
    NotFinite {
        /// The node.
        node: usize,
    },
    /// A triangle names a node that does not exist.
    #[error("element {element} names node {node}, but there are {nodes} nodes")]
    NoSuchNode {
        /// The element.
        element: usize,
        /// The index given.
        node: usize,
        /// Nodes of the mesh.
        nodes: usize,
    },
    /// A triangle runs clockwise.
    #[error(
        "element {element} is inverted (area {area:e} m2); its corners must run counter-clockwise"
    )]
    Inverted {
        /// The element.
        element: usize,
        /// Its signed area, m2.
        area: f64,
    },
    /// A triangle has no area.
    #[error("element {element} has no area ({area:e} m2)")]
    NoArea {
        /// The element.
        element: usize,
        /// Its signed area, m2.
        area: f64,
    },
    /// A node that no triangle uses.
    #[error("node {node} belongs to no element; remove it")]
    UnusedNode {
        /// The node.
        node: usize,
    },
    /// Elements overlap along an edge.
    #[error(
        "element {element} is the second on the same side of the edge from node {from} to {to}"
    )]
    Overlap {
        /// The element.
        element: usize,
        /// Start of the edge.
        from: usize,
        /// End of the edge.
        to: usize,
    },
    /// The sheet has several pieces.
    #[error("element {element} is not connected to element 0; the sheet must be one piece")]
    Disconnected {
        /// An element of another piece.
        element: usize,
    },
    /// An electrode without an edge.
    #[error("electrode {electrode} touches nothing: it has no edge")]
    NoEdge {
        /// The electrode.
        electrode: Electrode,
    },
    /// An electrode's edge is not on the boundary.
    #[error(
        "electrode {electrode}: the edge between nodes {from} and {to} is not a boundary edge of the mesh"
    )]
    NotBoundary {
        /// The electrode.
        electrode: Electrode,
        /// One end.
        from: usize,
        /// Other end.
        to: usize,
    },
    /// An electrode lists an edge twice.
    #[error("electrode {electrode} names the edge between nodes {from} and {to} a second time")]
    EdgeTwice {
        /// The electrode.
        electrode: Electrode,
        /// One end.
        from: usize,
        /// Other end.
        to: usize,
    },
    /// Two electrodes meet.
    #[error(
        "electrodes {first} and {second} meet at node {node}; leave at least one edge between them"
    )]
    ElectrodesMeet {
        /// First.
        first: Electrode,
        /// Second.
        second: Electrode,
        /// The node.
        node: usize,
    },
    /// The region is empty, or lists an element that does not exist, or one twice.
    #[error("the region of interest {fault}")]
    Region {
        /// What is wrong with it.
        fault: String,
    },
    /// The depth of the liquid or the heights of the electrodes are not consistent.
    #[error("depth: {fault}")]
    Depth {
        /// What is wrong with them.
        fault: String,
    },
    /// The dimensions of a preset are not consistent.
    #[error("preset '{preset}': {fault}")]
    Preset {
        /// Name of the preset.
        preset: &'static str,
        /// What is wrong, and with which key.
        fault: String,
    },
}
