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

/// The voltmeter's terminals.
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

#[cfg(test)]
mod tests {
    use super::*;

    const SOURCE_HI: Point = Point::Source(true);
    const SOURCE_LO: Point = Point::Source(false);

    fn resistor(from: Point, to: Point, ohms: f64) -> Resistor {
        Resistor { from, to, ohms }
    }

    fn joins(electrode: usize, to: Point, ohms: f64) -> Resistor {
        resistor(Point::Electrode(electrode), to, ohms)
    }

    /// A ring of equal resistors as a sheet: Z is the pseudo-inverse of its Laplacian.
    fn ring(electrodes: usize, ohms: f64) -> DMatrix<f64> {
        let mut laplacian = DMatrix::zeros(electrodes, electrodes);
        for k in 0..electrodes {
            let next = (k + 1) % electrodes;
            laplacian[(k, k)] += 1.0 / ohms;
            laplacian[(next, next)] += 1.0 / ohms;
            laplacian[(k, next)] -= 1.0 / ohms;
            laplacian[(next, k)] -= 1.0 / ohms;
        }
        laplacian.pseudo_inverse(1e-12).unwrap()
    }

    fn pair(k: usize, hi: Point, lo: Point, ohms: f64, electrodes: usize) -> [Resistor; 2] {
        [joins(k, hi, ohms), joins((k + 1) % electrodes, lo, ohms)]
    }

    #[test]
    fn pair_circuit_reads_four_entries_of_z_to_the_bit() {
        let z = ring(6, 1000.0);
        let inject = pair(0, SOURCE_HI, SOURCE_LO, 100.1, 6);
        let measure = pair(3, METER_HI, METER_LO, 100.1, 6);
        let flow = Flow::solve([inject, measure].concat(), &z);
        let expected = (z[(3, 0)] - z[(3, 1)]) - (z[(4, 0)] - z[(4, 1)]);
        assert!((flow.across(&z, METER_HI, METER_LO) - expected).abs() <= 1e-13 * expected.abs());
        // 1 kohm in parallel with five in series, and two poles of 100.1 ohm
        let seen = 5.0 / 6.0 * 1000.0 + 200.2;
        assert!((flow.resistance(&z) - seen).abs() < 1e-9);
    }

    #[test]
    fn nothing_closed_is_an_open_source_and_a_meter_at_zero() {
        let z = ring(6, 1000.0);
        let flow = Flow::solve(Vec::new(), &z);
        assert_eq!(flow.resistance(&z), f64::INFINITY);
        assert_eq!(flow.across(&z, METER_HI, METER_LO), 0.0);
        let half = Flow::solve(vec![joins(0, SOURCE_HI, 0.1)], &z);
        assert_eq!(half.resistance(&z), f64::INFINITY);
    }

    #[test]
    fn a_meter_on_one_wire_floats_at_zero() {
        let z = ring(6, 1000.0);
        let mut resistors = pair(0, SOURCE_HI, SOURCE_LO, 0.1, 6).to_vec();
        resistors.push(joins(3, METER_HI, 0.1));
        let flow = Flow::solve(resistors, &z);
        assert_eq!(flow.across(&z, METER_HI, METER_LO), 0.0);
    }

    #[test]
    fn neighbouring_pairs_short_the_source_at_shared_electrode() {
        // HI on electrodes 0 and 1, LO on 1 and 2: 0.1 + 0.1 ohm at electrode 1 carry nearly all
        let z = ring(6, 1000.0);
        let both = [
            pair(0, SOURCE_HI, SOURCE_LO, 0.1, 6),
            pair(1, SOURCE_HI, SOURCE_LO, 0.1, 6),
        ]
        .concat();
        let seen = Flow::solve(both, &z).resistance(&z);
        assert!((0.19..0.2).contains(&seen), "{seen}");
    }

    #[test]
    fn any_network_agrees_with_its_nodal_equations() {
        // Deterministic pseudo-random networks; the sheet enters the reference as its admittance.
        let electrodes = 5;
        let z = ring(electrodes, 700.0);
        let y = z.clone().pseudo_inverse(1e-9).unwrap();
        let points = [
            SOURCE_HI,
            SOURCE_LO,
            METER_HI,
            METER_LO,
            Point::Bus(2, true),
        ];
        let mut state = 12345_u64;
        let mut draw = |most: usize| {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 33) as usize % most
        };
        let mut compared = 0;
        for _ in 0..400 {
            let resistors: Vec<Resistor> = (0..2 + draw(9))
                .map(|_| {
                    joins(
                        draw(electrodes),
                        points[draw(5)],
                        [0.1, 70.0, 100.1][draw(3)],
                    )
                })
                .collect();
            let flow = Flow::solve(resistors.clone(), &z);
            // reference: nodal analysis with electrode potentials and points as unknowns, 1 pS to ground everywhere
            let size = electrodes + points.len();
            let at = |point: Point| match point {
                Point::Electrode(k) => k,
                other => electrodes + points.iter().position(|known| *known == other).unwrap(),
            };
            let mut nodal = DMatrix::zeros(size, size);
            nodal
                .view_mut((0, 0), (electrodes, electrodes))
                .copy_from(&y);
            for resistor in &resistors {
                let (a, b) = (at(resistor.from), at(resistor.to));
                let g = 1.0 / resistor.ohms;
                nodal[(a, a)] += g;
                nodal[(b, b)] += g;
                nodal[(a, b)] -= g;
                nodal[(b, a)] -= g;
            }
            for k in 0..size {
                nodal[(k, k)] += 1e-12;
            }
            if !flow.joined {
                continue;
            }
            let mut driven = DVector::zeros(size);
            driven[at(SOURCE_HI)] = 1.0;
            driven[at(SOURCE_LO)] = -1.0;
            let potentials = nodal.lu().solve(&driven).unwrap();
            let seen = potentials[at(SOURCE_HI)] - potentials[at(SOURCE_LO)];
            assert!(
                (seen - flow.resistance(&z)).abs() < 1e-5 * seen.max(1.0),
                "{seen}"
            );
            let read = flow.across(&z, METER_HI, METER_LO);
            let connected = |point| flow.tree.component[flow.tree.node(point)];
            if connected(METER_HI) == connected(METER_LO)
                && connected(METER_HI) == connected(SOURCE_HI)
            {
                let expected = potentials[at(METER_HI)] - potentials[at(METER_LO)];
                assert!(
                    (read - expected).abs() < 1e-5 * seen.max(1.0),
                    "{read} {expected}"
                );
                compared += 1;
            }
        }
        assert!(compared > 50, "{compared}");
    }
}
