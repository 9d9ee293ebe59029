// Ceres Solver on the benchmark's problem in three forms:
//   autodiff  a residual for each point, AutoDiff, Tukey's loss: what most programs do
//   block     one block of all points with its Jacobian by hand
//   tiny      the same block in TinySolver, which allocates nothing between steps
// usage: ceres_bench PROBLEM.bin FORM
// stdin:  "N K level_1 ... level_K\n", then N poses of 16 doubles; stdout: "cpu_seconds mean_evaluations\n", then poses.
#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <ceres/tiny_solver.h>

#include <ctime>
#include <iostream>
#include <memory>
#include <sstream>

#include "problem.h"

struct Solution {
  Vector6 y;
  int evaluations;
};

struct PointResidual {
  const Level& level;
  int index;

  template <typename T>
  bool operator()(const T* y, T* residual) const {
    const Problem& problem = level.problem;
    T lever[3], turn[3], p_base[3], q[3];
    for (int k = 0; k < 3; ++k) {
      lever[k] = level.points[index][k] - y[k] * problem.sigma[k];
      turn[k] = -y[k + 3] * problem.sigma[k + 3];
    }
    ceres::AngleAxisRotatePoint(turn, lever, p_base);
    const Pose& E = problem.T_cam_base;
    for (int k = 0; k < 3; ++k) q[k] = E(k, 0) * p_base[0] + E(k, 1) * p_base[1] + E(k, 2) * p_base[2] + E(k, 3);
    if (q[2] < 1e-2) q[2] = T(1e-2);
    const T u = problem.fx * q[0] / q[2] + problem.cx, v = problem.fy * q[1] / q[2] + problem.cy;
    residual[0] = sample(u, v);
    return true;
  }

 private:
  double sample(double u, double v) const { return lookup(level.image, level.channel[index], u, v).value; }

  template <typename T>
  T sample(const T& u, const T& v) const {
    const Sample s = lookup(level.image, level.channel[index], u.a, v.a);
    return s.value + s.du * (u - u.a) + s.dv * (v - v.a);
  }
};

struct PriorResidual {
  const Level& level;

  template <typename T>
  bool operator()(const T* y, T* residual) const {
    for (int k = 0; k < 6; ++k) residual[k] = y[k] - level.y_prior[k];
    return true;
  }
};

class BlockCost : public ceres::CostFunction {
 public:
  explicit BlockCost(const Level& level) : level_(level) {
    set_num_residuals(level.num_residuals());
    mutable_parameter_block_sizes()->push_back(6);
  }
  bool Evaluate(double const* const* y, double* residuals, double** jacobians) const override {
    level_.evaluate(y[0], residuals, jacobians ? jacobians[0] : nullptr, 6, 1);
    return true;
  }

 private:
  const Level& level_;
};

// Everybody's stopping rule: a step below the tolerance, in units of the prior's sigmas.
class SmallStep : public ceres::IterationCallback {
 public:
  explicit SmallStep(double tolerance) : tolerance_(tolerance) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& now) override {
    const bool is_small = now.iteration > 0 && now.step_is_successful && now.step_norm < tolerance_;
    return is_small ? ceres::SOLVER_TERMINATE_SUCCESSFULLY : ceres::SOLVER_CONTINUE;
  }

 private:
  double tolerance_;
};

Solution solve_ceres(ceres::Problem& problem, const Level& level, Vector6& y) {
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;  // faster than QR for six unknowns
  options.max_num_iterations = level.problem.max_steps - 1;   // one evaluation comes before the first iteration
  options.function_tolerance = options.gradient_tolerance = options.parameter_tolerance = 0;
  options.logging_type = ceres::SILENT;
  SmallStep small_step(level.problem.tolerance);
  options.callbacks.push_back(&small_step);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return {y, static_cast<int>(summary.iterations.size())};
}

Solution solve_autodiff(const Level& level) {
  Vector6 y = Vector6::Zero();
  ceres::Problem::Options ownership;
  ownership.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(ownership);
  ceres::TukeyLoss tukey(1.0);
  std::vector<std::unique_ptr<ceres::LossFunction>> losses;
  double gain = -1;
  for (size_t k = 0; k < level.points.size(); ++k) {
    if (level.gain[k] != gain) {  // one loss for all points of one weight
      gain = level.gain[k];
      losses.push_back(std::make_unique<ceres::ScaledLoss>(&tukey, gain, ceres::DO_NOT_TAKE_OWNERSHIP));
    }
    auto* cost = new ceres::AutoDiffCostFunction<PointResidual, 1, 6>(new PointResidual{level, static_cast<int>(k)});
    problem.AddResidualBlock(cost, losses.back().get(), y.data());
  }
  auto* prior = new ceres::AutoDiffCostFunction<PriorResidual, 6, 6>(new PriorResidual{level});
  problem.AddResidualBlock(prior, nullptr, y.data());
  return solve_ceres(problem, level, y);
}

Solution solve_block(const Level& level) {
  Vector6 y = Vector6::Zero();
  ceres::Problem problem;
  problem.AddResidualBlock(new BlockCost(level), nullptr, y.data());
  return solve_ceres(problem, level, y);
}

// TinySolver ends on ||step|| < tolerance (||z|| + tolerance): with z = y + a constant of norm 1 that is absolute.
struct TinyCost {
  using Scalar = double;
  enum { NUM_PARAMETERS = 6, NUM_RESIDUALS = Eigen::Dynamic };
  const Level& level;

  static Vector6 shift() { return Vector6::Unit(0); }
  int NumResiduals() const { return level.num_residuals(); }
  bool operator()(const double* z, double* residuals, double* jacobian) const {
    const Vector6 y = Eigen::Map<const Vector6>(z) - shift();
    level.evaluate(y.data(), residuals, jacobian, 1, NumResiduals());
    return true;
  }
};

Solution solve_tiny(const Level& level) {
  static ceres::TinySolver<TinyCost> solver;
  solver.options.max_num_iterations = level.problem.max_steps - 1;
  solver.options.parameter_tolerance = level.problem.tolerance;
  solver.options.gradient_tolerance = solver.options.cost_threshold = 0;
  solver.options.function_tolerance = 0;
  Vector6 z = TinyCost::shift();
  const auto& summary = solver.Solve(TinyCost{level}, &z);
  return {z - TinyCost::shift(), summary.iterations + 1};
}

double cpu_seconds() {
  timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}

int main(int argc, char** argv) {
  if (argc != 3) {
    std::cerr << "usage: ceres_bench PROBLEM.bin autodiff|block|tiny\n";
    return 2;
  }
  const Problem problem(argv[1]);
  const std::string form = argv[2];
  const auto solve = form == "autodiff" ? solve_autodiff : form == "block" ? solve_block : solve_tiny;
  std::string line;
  while (std::getline(std::cin, line)) {
    std::istringstream words(line);
    size_t num_poses, num_levels;
    words >> num_poses >> num_levels;
    std::vector<int> levels(num_levels);
    for (int& level : levels) words >> level;
    std::vector<Pose> poses(num_poses);
    std::cin.read(reinterpret_cast<char*>(poses.data()), num_poses * sizeof(Pose));
    const double begin = cpu_seconds();
    long evaluations = 0;
    for (Pose& pose : poses) {
      for (int index : levels) {
        const Level level(problem, index, pose);
        const Solution found = solve(level);
        pose = level.pose(found.y);
        evaluations += found.evaluations;
      }
    }
    std::cout << cpu_seconds() - begin << " " << static_cast<double>(evaluations) / num_poses << "\n";
    std::cout.write(reinterpret_cast<const char*>(poses.data()), num_poses * sizeof(Pose)).flush();
  }
}
