//! Exact plane geometry in integers: the oracle for regions whose numbers are multiples of one small unit.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

/// A point in whole units.
pub type Point = (i128, i128);

/// A closed box in whole units: `(min, max)`.
pub type Square = (Point, Point);

/// A region in whole units.
#[derive(Debug, Clone)]
pub enum Shape {
    Rectangle(Point, Point),
    Disc(Point, i128),
    Polygon(Vec<Point>),
    Path(Vec<Point>, i128),
}

impl Shape {
    /// Do the closed region and the closed box have a point in common?
    pub fn meets(&self, square: Square) -> bool {
        match self {
            Self::Rectangle(min, max) => {
                min.0 <= square.1.0 && max.0 >= square.0.0 && min.1 <= square.1.1 && max.1 >= square.0.1
            }
            Self::Disc(center, radius) => gap_squared(*center, square) <= radius * radius,
            Self::Polygon(points) => {
                edges(points).any(|(a, b)| capsule_meets(a, b, 0, square)) || inside(points, square.0)
            }
            Self::Path(points, radius) if points.len() == 1 => gap_squared(points[0], square) <= radius * radius,
            Self::Path(points, radius) => points.windows(2).any(|p| capsule_meets(p[0], p[1], *radius, square)),
        }
    }

    /// The smallest box that encloses the region.
    pub fn bounds(&self) -> Square {
        let hull = |points: &[Point], r: i128| {
            let (xs, ys) = (points.iter().map(|p| p.0), points.iter().map(|p| p.1));
            let min = (xs.clone().min().unwrap() - r, ys.clone().min().unwrap() - r);
            (min, (xs.max().unwrap() + r, ys.max().unwrap() + r))
        };
        match self {
            Self::Rectangle(min, max) => (*min, *max),
            Self::Disc(center, radius) => hull(&[*center], *radius),
            Self::Polygon(points) => hull(points, 0),
            Self::Path(points, radius) => hull(points, *radius),
        }
    }
}

fn edges(points: &[Point]) -> impl Iterator<Item = (Point, Point)> + '_ {
    (0..points.len()).map(|i| (points[i], points[(i + 1) % points.len()]))
}

fn cross(o: Point, a: Point, b: Point) -> i128 {
    (a.0 - o.0) * (b.1 - o.1) - (a.1 - o.1) * (b.0 - o.0)
}

fn gap_squared(p: Point, (min, max): Square) -> i128 {
    let dx = (min.0 - p.0).max(p.0 - max.0).max(0);
    let dy = (min.1 - p.1).max(p.1 - max.1).max(0);
    dx * dx + dy * dy
}

fn corners((min, max): Square) -> [Point; 4] {
    [min, (max.0, min.1), max, (min.0, max.1)]
}

/// Do two closed segments have a point in common?
fn segments_meet(a: Point, b: Point, c: Point, d: Point) -> bool {
    let sides = [cross(a, b, c), cross(a, b, d), cross(c, d, a), cross(c, d, b)].map(i128::signum);
    if sides[0] * sides[1] < 0 && sides[2] * sides[3] < 0 {
        return true;
    }
    let within = |p: Point, q: Point, r: Point| {
        r.0 >= p.0.min(q.0) && r.0 <= p.0.max(q.0) && r.1 >= p.1.min(q.1) && r.1 <= p.1.max(q.1)
    };
    (sides[0] == 0 && within(a, b, c))
        || (sides[1] == 0 && within(a, b, d))
        || (sides[2] == 0 && within(c, d, a))
        || (sides[3] == 0 && within(c, d, b))
}

/// Does a box come within `r` of a segment?
fn capsule_meets(a: Point, b: Point, r: i128, square: Square) -> bool {
    if gap_squared(a, square) <= r * r || gap_squared(b, square) <= r * r {
        return true;
    }
    let corners = corners(square);
    if (0..4).any(|i| segments_meet(a, b, corners[i], corners[(i + 1) % 4])) {
        return true;
    }
    let length_squared = (b.0 - a.0).pow(2) + (b.1 - a.1).pow(2);
    length_squared > 0
        && corners.iter().any(|c| {
            let along = (c.0 - a.0) * (b.0 - a.0) + (c.1 - a.1) * (b.1 - a.1);
            (0..=length_squared).contains(&along) && cross(a, b, *c).pow(2) <= r * r * length_squared
        })
}

/// Is a point that is not on the boundary inside by the even-odd rule?
fn inside(points: &[Point], p: Point) -> bool {
    let crossed = edges(points).filter(|(a, b)| {
        let (low, high) = if a.1 <= b.1 { (*a, *b) } else { (*b, *a) };
        low.1 <= p.1 && p.1 < high.1 && cross(low, high, p) > 0
    });
    crossed.count() % 2 == 1
}

/// A small generator of random numbers (SplitMix64).
#[derive(Debug, Clone)]
pub struct Dice(pub u64);

impl Dice {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A whole number of `lo..=hi`.
    pub fn whole(&mut self, lo: i128, hi: i128) -> i128 {
        lo + i128::from(self.next()) % (hi - lo + 1)
    }

    /// A number of `[lo, hi)`.
    pub fn real(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * ((self.next() >> 11) as f64 / (1_u64 << 53) as f64)
    }

    pub fn chance(&mut self, p: f64) -> bool {
        self.real(0.0, 1.0) < p
    }

    pub fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.next() as usize % from.len()]
    }
}

/// A random region with corners in `lo..=hi`, degenerate ones among them.
pub fn random_shape(dice: &mut Dice, lo: i128, hi: i128, leaf: i128) -> Shape {
    // Multiples of the leaf's side are edges of leaves.
    let grain = dice.pick(&[1, 1, 1, leaf, leaf / 2]);
    let coordinate = |dice: &mut Dice| dice.whole(lo / grain, hi / grain) * grain;
    let radius = |dice: &mut Dice| dice.pick(&[0, 1, leaf, leaf / 2 + 1, 3 * leaf, 5 * leaf + 3]);
    match dice.whole(0, 3) {
        0 => {
            let (a, b) = ((coordinate(dice), coordinate(dice)), (coordinate(dice), coordinate(dice)));
            let (mut min, mut max) = ((a.0.min(b.0), a.1.min(b.1)), (a.0.max(b.0), a.1.max(b.1)));
            if dice.chance(0.2) {
                max.0 = min.0;
            }
            if dice.chance(0.2) {
                min.1 = max.1;
            }
            Shape::Rectangle(min, max)
        }
        1 => Shape::Disc((coordinate(dice), coordinate(dice)), radius(dice)),
        2 => {
            let count = dice.pick(&[3, 3, 4, 5, 9, 17]);
            let (x, y) = (coordinate(dice), coordinate(dice));
            let collinear = dice.chance(0.15);
            let points = (0..count).map(|_| {
                let t = dice.whole(-6, 6);
                if collinear { (x + t * grain, y + 2 * t * grain) } else { (coordinate(dice), coordinate(dice)) }
            });
            Shape::Polygon(points.collect())
        }
        _ => {
            let count = dice.pick(&[1, 2, 2, 3, 6]);
            let mut points: Vec<Point> = (0..count).map(|_| (coordinate(dice), coordinate(dice))).collect();
            if dice.chance(0.2) {
                points.push(points[0]);
                points.push(points[0]);
            }
            Shape::Path(points, radius(dice))
        }
    }
}
