use crate::linear_algebra::sparse::*;

#[test]
fn a_path_of_resistors_is_solved() {
    let size = 40;
    let links = || (1..size).map(|k| [k - 1, k]);
    let pattern = Analysis::new(&[7, 13, 20], links()).unwrap();
    let mut values = vec![0.0; pattern.entries()];
    for [a, b] in links() {
        values[pattern.entry(a, b).unwrap()] -= 1.0;
        values[pattern.entry(a, a).unwrap()] += 1.0;
        values[pattern.entry(b, b).unwrap()] += 1.0;
    }
    values[pattern.entry(0, 0).unwrap()] += 1.0;
    let mut factor = Factor::passing(&pattern).unwrap();
    factor.make(&pattern, &values).unwrap();
    let mut block = Block::zeros(size, 5);
    block.row_mut(size - 1)[3] = 2.0;
    factor.solve(&pattern, None, &mut block);
    for k in 0..size {
        assert!((block.row(k)[3] - 2.0 * (k + 1) as f64).abs() < 1e-12);
        assert_eq!(block.row(k)[0], 0.0);
    }
    assert_eq!(pattern.entry(0, 5), None);
    values[0] = -9.0;
    assert_eq!(
        factor.make(&pattern, &values),
        Err(SparseError::NotDefinite)
    );
}

#[test]
fn dissection_keeps_every_point_once() {
    let points: Vec<[f64; 2]> = (0..900)
        .map(|k| [(k % 30) as f64, (k / 30) as f64])
        .collect();
    let neighbours: Vec<Vec<usize>> = points
        .iter()
        .map(|p| {
            (0..900)
                .filter(|&q: &usize| {
                    (points[q][0] - p[0]).abs() + (points[q][1] - p[1]).abs() == 1.0
                })
                .collect()
        })
        .collect();
    let (mut order, parts) = dissect(&points, &neighbours);
    assert_eq!(parts.iter().sum::<usize>(), 900);
    order.sort_unstable();
    assert_eq!(order, (0..900).collect::<Vec<_>>());
}
