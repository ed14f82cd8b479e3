//! Computes the currents: a source, a sheet, and the resistances of the closed relays between them.
//!
//! The sheet is given by its transfer impedance Z (electrode potentials U = Z J, J the currents into it, with sum
//! zero). Everything else is resistors between points. Loop currents are the unknowns: a spanning tree carries the
//! source's ampere, every resistor outside it closes one loop, and for the loop currents x
//!
//! ```text
//! Cᵀ (R + Bᵀ Z B) C x = - Cᵀ (R + Bᵀ Z B) p
//! ```
//!
//! where p is the tree's flow, C the loops, R the resistances and B the resistors' ends on the sheet. With one
//! injecting and one measuring pair closed there is no loop and nothing to solve: the reading is the current times four
//! entries of Z, without further rounding.

pub(crate) mod load_network;
pub(crate) mod sheet;
pub(crate) mod terminals;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{DMatrix, DVector};

/// A node of the circuit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) enum Point {
    /// A contact of the sheet.
    Electrode(usize),
    /// The source's HI (`true`) or LO.
    Source(bool),
    /// One wire, H (`true`) or L, of an analogue bus; the voltmeter is connected to bus 1.
    Bus(u32, bool),
    /// A terminal of a load of resistors.
    Terminal(usize),
    /// A node inside such a load.
    Node(usize),
    /// One wire of a bank's common, or of a matrix row, without another connection: slot, number, wire.
    Common(u32, u32, bool),
}

/// Terminals of the voltmeter.
pub(crate) const METER_HI: Point = Point::Bus(1, true);
pub(crate) const METER_LO: Point = Point::Bus(1, false);

/// A resistance between two points: one pole of a closed relay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Resistor {
    pub(crate) from: Point,
    pub(crate) to: Point,
    pub(crate) ohms: f64,
}

/// The distribution of one ampere from source HI to source LO. Everything is linear in it.
#[derive(Debug)]
pub(crate) struct Flow {
    resistors: Vec<Resistor>,
    /// Through each resistor, in its direction, per ampere of the source.
    currents: Vec<f64>,
    /// Into the sheet, at each electrode with a current.
    entering: BTreeMap<usize, f64>,
    tree: Tree,
    joined: bool,
}

/// A spanning tree; the sheet is one node (0), every other point a node of its own.
#[derive(Debug, Default)]
struct Tree {
    number: BTreeMap<Point, usize>,
    /// The resistor to the parent of each node, and whether the path from the parent follows its direction. `None` at a
    /// root.
    reached_by: Vec<Option<(usize, bool)>>,
    component: Vec<usize>,
    depth: Vec<usize>,
}

impl Tree {
    fn grow(resistors: &[Resistor]) -> Self {
        let mut tree = Self::default();
        let mut nodes = 1;
        let points: BTreeSet<Point> = resistors
            .iter()
            .flat_map(|resistor| [resistor.from, resistor.to])
            .chain([
                Point::Source(true),
                Point::Source(false),
                METER_HI,
                METER_LO,
            ])
            .collect();
        for point in points {
            if !matches!(point, Point::Electrode(_)) {
                tree.number.insert(point, nodes);
                nodes += 1;
            }
        }
        tree.reached_by = vec![None; nodes];
        tree.component = vec![usize::MAX; nodes];
        tree.depth = vec![0; nodes];
        let mut neighbours: Vec<Vec<(usize, bool)>> = vec![Vec::new(); nodes];
        for (index, resistor) in resistors.iter().enumerate() {
            neighbours[tree.node(resistor.from)].push((index, true));
            neighbours[tree.node(resistor.to)].push((index, false));
        }
        for root in 0..nodes {
            if tree.component[root] != usize::MAX {
                continue;
            }
            tree.component[root] = root;
            let mut queue = std::collections::VecDeque::from([root]);
            while let Some(node) = queue.pop_front() {
                for (index, forward) in &neighbours[node] {
                    let resistor = &resistors[*index];
                    let next = tree.node(if *forward { resistor.to } else { resistor.from });
                    if tree.component[next] == usize::MAX {
                        tree.component[next] = root;
                        tree.reached_by[next] = Some((*index, *forward));
                        tree.depth[next] = tree.depth[node] + 1;
                        queue.push_back(next);
                    }
                }
            }
        }
        tree
    }

    fn node(&self, point: Point) -> usize {
        match point {
            Point::Electrode(_) => 0,
            other => self.number[&other],
        }
    }

    /// The resistors on the path from one node to another, and whether each is passed in its own direction.
    fn path_between(&self, resistors: &[Resistor], from: usize, to: usize) -> Vec<(usize, bool)> {
        let (mut up, mut down) = (Vec::new(), Vec::new());
        let (mut here, mut there) = (from, to);
        let parent = |node: usize| {
            let (index, forward) =
                self.reached_by[node].expect("above a root lies nothing: both ends share one");
            let resistor = &resistors[index];
            let parent = self.node(if forward { resistor.from } else { resistor.to });
            (index, forward, parent)
        };
        while here != there {
            if self.depth[here] >= self.depth[there] {
                let (index, forward, above) = parent(here);
                up.push((index, !forward));
                here = above;
            } else {
                let (index, forward, above) = parent(there);
                down.push((index, forward));
                there = above;
            }
        }
        down.reverse();
        up.extend(down);
        up
    }
}

impl Flow {
    /// Solves the network for one ampere; `z` is the sheet's transfer impedance.
    pub(crate) fn solve(resistors: Vec<Resistor>, z: &DMatrix<f64>) -> Self {
        let tree = Tree::grow(&resistors);
        let (hi, lo) = (
            tree.node(Point::Source(true)),
            tree.node(Point::Source(false)),
        );
        let joined = tree.component[hi] == tree.component[lo];
        let mut currents = vec![0.0; resistors.len()];
        if joined {
            for (index, forward) in tree.path_between(&resistors, hi, lo) {
                currents[index] += if forward { 1.0 } else { -1.0 };
            }
            let loops = loops(&tree, &resistors);
            if !loops.is_empty() {
                close_loops(&loops, &resistors, z, &mut currents);
            }
        }
        let entering = entering(&resistors, &currents);
        Self {
            resistors,
            currents,
            entering,
            tree,
            joined,
        }
    }

    /// Load resistance of the source, ohm; infinite if nothing connects its terminals.
    pub(crate) fn resistance(&self, z: &DMatrix<f64>) -> f64 {
        if !self.joined {
            return f64::INFINITY;
        }
        self.across(z, Point::Source(true), Point::Source(false))
    }

    /// Solves the network for one ampere from one point to another, which replace the source's terminals: `resistance`
    /// is then the resistance between these points.
    pub(crate) fn solve_between(
        mut resistors: Vec<Resistor>,
        [from, to]: [Point; 2],
        z: &DMatrix<f64>,
    ) -> Self {
        let place = |point: Point| match point {
            Point::Source(true) => from,
            Point::Source(false) => to,
            _ if point == from => Point::Source(true),
            _ if point == to => Point::Source(false),
            other => other,
        };
        for resistor in &mut resistors {
            resistor.from = place(resistor.from);
            resistor.to = place(resistor.to);
        }
        Self::solve(resistors, z)
    }

    /// Whether two points are connected.
    pub(crate) fn joins(&self, one: Point, other: Point) -> bool {
        let component = |point| match point {
            Point::Electrode(_) => Some(self.tree.component[0]),
            point => Some(self.tree.component[*self.tree.number.get(&point)?]),
        };
        component(one).is_some_and(|found| component(other) == Some(found))
    }

    /// Voltage between two points per ampere, V. Zero for two points without connection: the voltmeter's own input
    /// resistance, however large, pulls an open input to zero.
    pub(crate) fn across(&self, z: &DMatrix<f64>, hi: Point, lo: Point) -> f64 {
        if !self.joins(hi, lo) {
            return 0.0;
        }
        let (from, to) = (self.tree.node(hi), self.tree.node(lo));
        let way = self.tree.path_between(&self.resistors, from, to);
        let drops = |&(index, forward): &(usize, bool)| {
            let drop = self.resistors[index].ohms * self.currents[index];
            if forward { drop } else { -drop }
        };
        let wires: f64 = way.iter().map(drops).sum();
        wires + potential_along(&way, &self.resistors, z, &self.entering)
    }
}

/// Where the path enters and leaves the sheet, the potential difference of the sheet is added.
fn potential_along(
    way: &[(usize, bool)],
    resistors: &[Resistor],
    z: &DMatrix<f64>,
    entering: &BTreeMap<usize, f64>,
) -> f64 {
    let mut volts = 0.0;
    for (index, forward) in way {
        let resistor = &resistors[*index];
        let (start, end) = if *forward {
            (resistor.from, resistor.to)
        } else {
            (resistor.to, resistor.from)
        };
        // Potentials of the sheet are added at one end of a crossing and subtracted at the other.
        if let Point::Electrode(electrode) = end {
            volts += potential(electrode, z, entering);
        }
        if let Point::Electrode(electrode) = start {
            volts -= potential(electrode, z, entering);
        }
    }
    volts
}

fn potential(electrode: usize, z: &DMatrix<f64>, entering: &BTreeMap<usize, f64>) -> f64 {
    entering
        .iter()
        .map(|(at, current)| z[(electrode, *at)] * current)
        .sum()
}

/// Currents into the sheet at each electrode.
fn entering(resistors: &[Resistor], currents: &[f64]) -> BTreeMap<usize, f64> {
    let mut entering = BTreeMap::new();
    for (resistor, current) in resistors.iter().zip(currents) {
        if *current == 0.0 {
            continue;
        }
        if let Point::Electrode(electrode) = resistor.to {
            *entering.entry(electrode).or_insert(0.0) += current;
        }
        if let Point::Electrode(electrode) = resistor.from {
            *entering.entry(electrode).or_insert(0.0) -= current;
        }
    }
    entering
}

/// One loop for each resistor outside the tree: through it, and back along the tree.
fn loops(tree: &Tree, resistors: &[Resistor]) -> Vec<Vec<(usize, bool)>> {
    let in_tree: BTreeSet<usize> = tree
        .reached_by
        .iter()
        .flatten()
        .map(|(index, _)| *index)
        .collect();
    (0..resistors.len())
        .filter(|index| !in_tree.contains(index))
        .map(|index| {
            let resistor = &resistors[index];
            let mut way = vec![(index, true)];
            way.extend(tree.path_between(
                resistors,
                tree.node(resistor.to),
                tree.node(resistor.from),
            ));
            way
        })
        .collect()
}

/// Adds the loop currents.
fn close_loops(
    loops: &[Vec<(usize, bool)>],
    resistors: &[Resistor],
    z: &DMatrix<f64>,
    currents: &mut [f64],
) {
    // The voltage round a loop, for given currents in all resistors and into the sheet.
    let around =
        |way: &[(usize, bool)], currents: &[f64], entering: &BTreeMap<usize, f64>| -> f64 {
            let wires: f64 = way
                .iter()
                .map(|(index, forward)| {
                    let drop = resistors[*index].ohms * currents[*index];
                    if *forward { drop } else { -drop }
                })
                .sum();
            wires + potential_along(way, resistors, z, entering)
        };
    let count = loops.len();
    let mut matrix = DMatrix::zeros(count, count);
    for (column, way) in loops.iter().enumerate() {
        let mut unit = vec![0.0; currents.len()];
        for (index, forward) in way {
            unit[*index] += if *forward { 1.0 } else { -1.0 };
        }
        let entering = entering(resistors, &unit);
        for (row, other) in loops.iter().enumerate() {
            matrix[(row, column)] = around(other, &unit, &entering);
        }
    }
    let entering = entering(resistors, currents);
    let driven = loops.iter().map(|way| -around(way, currents, &entering));
    let driven = DVector::from_iterator(count, driven);
    // Every loop contains a relay, and every relay has a resistance: the matrix is positive definite.
    let Some(flows) = matrix.lu().solve(&driven) else {
        return;
    };
    for (way, flow) in loops.iter().zip(flows.iter()) {
        for (index, forward) in way {
            currents[*index] += if *forward { *flow } else { -*flow };
        }
    }
}
