#!/usr/bin/env bash
#SBATCH --job-name=gonio
#SBATCH --array=1-8               # the parts of the campaign: as many nodes as you may have at a time
#SBATCH --nodes=1
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=16
#SBATCH --mem=16G
#SBATCH --time=12:00:00
#SBATCH --output=gonio-%A-%a.log
#SBATCH --signal=B:INT@60         # a minute before its time is up: what is finished is kept anyway
#
#     sbatch slurm_array.sh CAMPAIGN.toml DIR
#
# Each task of the array computes one part of the campaign. Submit it again to continue: finished units are kept.
set -euo pipefail

campaign=${1:?"usage: sbatch slurm_array.sh CAMPAIGN.toml DIR"}
folder=${2:?"usage: sbatch slurm_array.sh CAMPAIGN.toml DIR"}

# Tasks are counted from SLURM_ARRAY_TASK_MIN, whatever --array says.
part=$((SLURM_ARRAY_TASK_ID - SLURM_ARRAY_TASK_MIN + 1))/$SLURM_ARRAY_TASK_COUNT

# Put here what makes gonio available: module load python; source ~/venvs/gonio/bin/activate

exec gonio campaign run "$campaign" --output "$folder" --shard "$part" --threads "${SLURM_CPUS_PER_TASK:-1}"
