// Gazebo 11 world plugin: another program flies a camera, and the world steps only as far as it grants.
//
// Topic ~/skysweep/camera (gazebo.msgs.Pose): the pose of the optical centre in the world, axes forward, left,
// up. `id` is how many steps the world may take from there; the pose holds for all of them. The camera hangs on
// a mount, which takes the position, and three joints (yaw, roll, pitch), which take the attitude.
//
// SDF: <plugin name="skysweep_gate" filename="..."><model>MODEL</model></plugin>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <string>

#include <gazebo/gazebo.hh>
#include <gazebo/physics/physics.hh>
#include <gazebo/transport/transport.hh>

namespace gazebo {

class Gate : public WorldPlugin {
 public:
  void Load(physics::WorldPtr world, sdf::ElementPtr sdf) override {
    this->world = world;
    this->modelName = sdf->Get<std::string>("model");
    this->node = transport::NodePtr(new transport::Node());
    this->node->Init(world->Name());
    this->poses = this->node->Subscribe("~/skysweep/camera", &Gate::OnPose, this);
    this->interrupted = event::Events::ConnectSigInt([this]() { this->Open(); });
    this->update = event::Events::ConnectWorldUpdateBegin([this](const common::UpdateInfo &) { this->OnUpdate(); });
  }

 private:
  void OnPose(ConstPosePtr &message) {
    std::lock_guard<std::mutex> lock(this->mutex);
    this->pose = msgs::ConvertIgn(*message);
    this->granted += message->id();
    this->changed.notify_all();
  }

  void Open() {
    std::lock_guard<std::mutex> lock(this->mutex);
    this->open = true;
    this->changed.notify_all();
  }

  void OnUpdate() {
    ignition::math::Pose3d pose;
    {
      std::unique_lock<std::mutex> lock(this->mutex);
      this->changed.wait(lock, [this]() { return this->open || this->granted > 0; });
      if (this->granted > 0) --this->granted;
      pose = this->pose;
    }
    const physics::ModelPtr model = this->world->ModelByName(this->modelName);
    if (model) Point(*model, pose);
  }

  // R = Rz(yaw) Rx(roll) Ry(pitch), as the gimbal's joints follow one another.
  static void Point(physics::Model &model, const ignition::math::Pose3d &pose) {
    const ignition::math::Matrix3d R(pose.Rot());
    const double roll = std::asin(std::max(-1.0, std::min(1.0, R(2, 1))));
    const double yaw = std::atan2(-R(0, 1), R(1, 1));
    const double pitch = std::atan2(-R(2, 0), R(2, 2));
    model.SetWorldPose(ignition::math::Pose3d(pose.Pos(), ignition::math::Quaterniond::Identity));
    model.SetJointPosition(model.GetName() + "::yaw", yaw);
    model.SetJointPosition(model.GetName() + "::roll", roll);
    model.SetJointPosition(model.GetName() + "::pitch", pitch);
    model.SetWorldTwist({0, 0, 0}, {0, 0, 0});
  }

  physics::WorldPtr world;
  std::string modelName;
  transport::NodePtr node;
  transport::SubscriberPtr poses;
  event::ConnectionPtr interrupted, update;
  std::mutex mutex;
  std::condition_variable changed;
  ignition::math::Pose3d pose{0, 0, 100, 0, 0, 0};
  unsigned granted = 0;
  bool open = false;
};

GZ_REGISTER_WORLD_PLUGIN(Gate)

}  // namespace gazebo
